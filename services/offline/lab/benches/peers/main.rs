//! Compares the same layers and batches in our kernels, faer, ONNX Runtime and PyTorch. The libraries
//! alternate within one run, on one thread each.
//!
//! ```console
//! $ cargo bench --package stgdat-lab --bench peers -- --table docs/results/speed.md
//! ```
//!
//! ONNX Runtime and PyTorch run in a Python environment: the one of `--python`, or one that the bench makes
//! once (up to 7 GB). Without an environment they are skipped.

mod layers;
mod python;

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use console::failure::Failure;
use console::{program, show, tables};
use launch::bench::{machine, percentile};
use nn::Weights;
use nn::kernels::{self, peak};
use run::Exit;

use layers::Layer;
use python::Python;

/// Number of turns. In each turn every library runs every layer once.
const TURNS: usize = 15;
/// Time for which a library repeats a layer in a turn; the fastest call counts.
const TIME: Duration = Duration::from_millis(80);

/// The libraries, in the order of the table's columns.
const NAMES: [&str; 4] = ["ours", "faer", "ONNX Runtime", "PyTorch"];

/// Times of one layer: the fastest call of each turn, ms. `None` if the library does not have the layer.
#[derive(Default)]
struct Times([Vec<Option<f64>>; NAMES.len()]);

impl Times {
    fn take(&mut self, turn: [Option<f64>; NAMES.len()]) {
        self.0.iter_mut().zip(turn).for_each(|(times, time)| times.push(time));
    }

    fn best(&self, library: usize) -> Option<f64> {
        self.0[library].iter().flatten().copied().reduce(f64::min)
    }

    /// Median over the turns of our time divided by the library's time in the same turn.
    fn ratio(&self, library: usize) -> Option<f64> {
        let pairs = self.0[0].iter().zip(&self.0[library]);
        let mut ratios: Vec<f64> = pairs.filter_map(|(ours, theirs)| Some((*ours)? / (*theirs)?)).collect();
        (!ratios.is_empty()).then(|| percentile(&mut ratios, 0.5))
    }
}

/// Options of the bench.
#[derive(Debug, Parser)]
struct Arguments {
    /// Python with numpy, onnx, onnxruntime and torch, instead of an environment of its own
    #[arg(long, value_name = "PROGRAM")]
    python: Option<PathBuf>,
    /// Markdown file whose marks `stgdat bench peers` get the table, as the section of this processor
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    // Cargo passes this flag.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    program::end(execute(&arguments))
}

fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let text = table(arguments.python.clone())?;
    // All layers compute in f32.
    let heading = machine(&[])?;
    let exit = show::show(&format!("### {heading}\n\n{text}"))?;
    if let Some(path) = &arguments.table {
        tables::replace_section(path, "bench peers", &heading, &text)?;
    }
    Ok(exit)
}

/// The table, with the versions of the libraries.
fn table(python: Option<PathBuf>) -> Result<String, Failure> {
    let mut layers = layers::all(&Weights::onboard())?;
    let (mut python, versions) = match Python::start(python) {
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
    Ok(text(&layers, &times, peak_gflops, &versions))
}

fn text(layers: &[Layer], times: &[Times], peak_gflops: f64, versions: &str) -> String {
    let isa = kernels::active();
    let forced = match kernels::forced() {
        Some(_) => " The others take the fastest set of this processor.",
        None => "",
    };
    let mut text = format!(
        "{isa} kernels, one thread each, the best of {TURNS} turns in ms; multiply-adds in registers {peak_gflops:.0} \
         GFLOP/s; load average {} at the end. {versions}.{forced}\n\n| layer | GFLOP |",
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

/// The load average of the last minute; a high value reveals other work on the machine.
fn load_average() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().unwrap_or("unknown").to_owned()
}
