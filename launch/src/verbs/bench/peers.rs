//! `--peers`: the same layers and batches in faer, ONNX Runtime and PyTorch, by turns in the same run.

mod layers;
mod python;

use std::path::PathBuf;
use std::time::Duration;

use nn::kernels::{self, peak};

use super::{Arguments, percentile};
use crate::failure::Failure;
use layers::Layer;
use python::Python;

/// Turns in which each library has each layer once.
const TURNS: usize = 15;
/// How long a library repeats a layer in a turn; the best call counts.
const TIME: Duration = Duration::from_millis(80);

/// Who is timed, in the order of the table's columns.
const NAMES: [&str; 4] = ["ours", "faer", "ONNX Runtime", "PyTorch"];

/// Times of one layer: the best call of each turn, ms; none where the library has no such layer.
#[derive(Default)]
struct Times([Vec<Option<f64>>; NAMES.len()]);

impl Times {
    fn take(&mut self, turn: [Option<f64>; NAMES.len()]) {
        self.0.iter_mut().zip(turn).for_each(|(times, time)| times.push(time));
    }

    fn best(&self, library: usize) -> Option<f64> {
        self.0[library].iter().flatten().copied().reduce(f64::min)
    }

    /// Median over the turns of our time over the library's in the same turn.
    fn ratio(&self, library: usize) -> Option<f64> {
        let pairs = self.0[0].iter().zip(&self.0[library]);
        let mut ratios: Vec<f64> = pairs.filter_map(|(ours, theirs)| Some((*ours)? / (*theirs)?)).collect();
        (!ratios.is_empty()).then(|| percentile(&mut ratios, 0.5))
    }
}

/// The table, with what it was measured on.
pub(super) fn table(arguments: &Arguments, python: Option<PathBuf>) -> Result<String, Failure> {
    let (_, weights) = arguments.model.open_weights(None)?;
    let mut layers = layers::all(&weights)?;
    let (mut python, told) = match Python::start(python) {
        Ok((python, versions)) => (Some(python), versions),
        Err(why) => (None, format!("ONNX Runtime and PyTorch are skipped: {why}")),
    };
    let mut times: Vec<Times> = layers.iter().map(|_| Times::default()).collect();
    let mut peak_gflops = 0.0_f64;
    for _ in 0..TURNS {
        peak_gflops = peak_gflops.max(peak::fma_gflops(TIME));
        for (layer, times) in layers.iter_mut().zip(&mut times) {
            let ours = (layer.ours)();
            let faer = layer.faer.as_mut().map(|faer| faer());
            let mut theirs = |library| match &mut python {
                Some(python) => python.best_ms(library, layer.key, TIME),
                None => Ok(None),
            };
            times.take([Some(ours), faer, theirs("onnxruntime")?, theirs("torch")?]);
        }
    }
    Ok(text(&layers, &times, peak_gflops, &told))
}

fn text(layers: &[Layer], times: &[Times], peak_gflops: f64, told: &str) -> String {
    let isa = kernels::active();
    let forced = match kernels::forced() {
        Some(_) => " The others take the fastest set of this processor.",
        None => "",
    };
    let mut text = format!(
        "{isa} kernels, one thread each, the best of {TURNS} turns in ms; multiply-adds in registers {peak_gflops:.0} \
         GFLOP/s; load average {} at the end. {told}.{forced}\n\n| layer | GFLOP |",
        load_average(),
    );
    NAMES.iter().for_each(|name| text += &format!(" {name} |"));
    NAMES[1..].iter().for_each(|name| text += &format!(" ours / {name} |"));
    text += " ours, of the peak |\n|---|---:|";
    text += &"---:|".repeat(2 * NAMES.len());
    text += "\n";
    let shown = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
    };
    for (layer, times) in layers.iter().zip(times) {
        text += &format!("| {} | {:.3} |", layer.title, layer.operations * 1e-9);
        (0..NAMES.len()).for_each(|library| text += &format!(" {} |", shown(times.best(library), 3)));
        (1..NAMES.len()).for_each(|library| text += &format!(" {} |", shown(times.ratio(library), 2)));
        let share = times.best(0).map(|ms| layer.operations / (ms * 1e6) / peak_gflops);
        text += &format!(" {} |\n", shown(share, 2));
    }
    text + "\nA ratio is the median over the turns; under 1 ours is faster. Ours of the decoder is burn-in, recurrence and \
            heads, theirs the recurrence alone, and faer's its products alone, as for the relation MLP.\n"
}

/// The load of the last minute, which says whether something else ran.
fn load_average() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().unwrap_or("unknown").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_medians_of_the_turns_in_which_both_were_timed() {
        let mut times = Times::default();
        for (ours, faer) in [(2.0, Some(4.0)), (3.0, Some(3.0)), (9.0, None), (4.0, Some(1.0))] {
            times.take([Some(ours), faer, None, None]);
        }
        assert_eq!((times.best(0), times.best(1), times.best(2)), (Some(2.0), Some(1.0), None));
        assert_eq!((times.ratio(1), times.ratio(3)), (Some(1.0), None));
    }
}
