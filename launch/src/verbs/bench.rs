mod chain;
mod cost;
mod handover;
mod modes;
mod pipe;
mod stages;
mod work;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use nn::kernels;
use run::{Exit, Run};
use wire::StageId;

use crate::arguments::{ModelArguments, SetArguments};
use crate::fail_if::{self, Condition};
use crate::failure::Failure;
use crate::options::{Setting, StageOptions};
use crate::show::show;
use crate::tables;
use crate::version;

/// Duration of each peak measurement.
const PEAK_TIME: Duration = Duration::from_millis(400);

/// Arguments of `stgdat bench`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Numbers of agents to measure compute with
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [1, 16, 64, 128],
          value_parser = clap::value_parser!(u16).range(1..=wire::AGENTS_MAX as i64))]
    agents: Vec<u16>,
    /// Measured ticks per number of agents
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..))]
    ticks: u64,
    /// Seconds for which the whole pipeline runs at 12.5 Hz; 0 skips it
    #[arg(long, value_name = "S", default_value_t = 20)]
    seconds: u64,
    /// Measure what agents and modes cost instead: 1 to 128 agents by 1, 6 and 20 modes
    #[arg(long, conflicts_with = "agents")]
    cost: bool,
    /// Fail, with exit code 70, where the run of --seconds has such a figure, as `end_to_end_p99 > 75 ms`; may be
    /// given several times, and a wrong name lists the figures that there are
    #[arg(long, value_name = "CONDITION", conflicts_with = "cost")]
    fail_if: Vec<Condition>,
    /// Markdown file whose marks `stgdat bench` (`stgdat bench cost`) get the tables, as the
    /// section of this processor
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArguments,
    #[command(flatten)]
    set: SetArguments,
}

/// Measures compute per stage, the overhead of the pipeline and this machine's peaks in one run, or only the
/// requested part.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if !arguments.fail_if.is_empty() && arguments.seconds == 0 {
        return Err(Failure::Usage("--fail-if is about the run of --seconds, which is 0".to_owned()));
    }
    let mut report = None;
    let (mark, text) = if arguments.cost {
        ("bench cost", cost::table(arguments)?)
    } else {
        let mut text = speed(arguments)?;
        if arguments.seconds > 0 {
            let (run, measured) = chain::table(&arguments.model, &arguments.set, arguments.seconds)?;
            text += &run;
            report = Some(measured);
        }
        ("bench", text)
    };
    let heading = machine(&arguments.set.set)?;
    show(&format!("### {heading}\n\n{text}"))?;
    if let Some(path) = &arguments.table {
        tables::replace_section(path, mark, &heading, &text)?;
    }
    report.map_or(Ok(()), |report| fail_if::check(&arguments.fail_if, &report))?;
    Ok(Exit::Done)
}

/// Measures peaks, compute per stage and the hand-over to workers.
fn speed(arguments: &Arguments) -> Result<String, Failure> {
    let peak = kernels::peak::product_gflops(PEAK_TIME);
    let mut text = format!(
        "Matrix product {peak:.0} GFLOP/s and multiply-adds in registers {:.0} GFLOP/s on one thread.\n\n",
        kernels::peak::fma_gflops(PEAK_TIME),
    );
    text += &stages::table(arguments, peak)?;
    text += &handover::line()?.unwrap_or_default();
    Ok(text)
}

/// Describes the machine as a heading: the processor, its cores, the kernels, and the precision unless it is
/// f32.
///
/// # Errors
/// [`Failure`] if a setting can't be used.
pub fn machine(set: &[Setting]) -> Result<String, Failure> {
    let mut options = StageOptions::defaults(&[StageId::Decoder]);
    let of_decoder = set.iter().filter(|set| set.is_of(StageId::Decoder, "precision"));
    options.apply(&of_decoder.cloned().collect::<Vec<_>>())?;
    let kernels = version::kernels(&Run { stages: options.stage_runs(), ..Run::default() });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let cpus = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = processor(&cpus).unwrap_or("unknown processor").to_owned();
    Ok(format!("{model}, {cores} cores, {kernels}"))
}

/// Finds the processor's name in /proc/cpuinfo. Arm processors have no name there.
fn processor(cpus: &str) -> Option<&str> {
    let named = |line: &'_ str| line.starts_with("model name");
    let line = cpus.lines().find(|line| named(line))?;
    line.split_once(':').map(|(_, name)| name.trim())
}

/// The quantile `share` of `values`, by nearest rank.
pub fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.clamp(1, values.len().max(1)) - 1).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_by_nearest_rank() {
        let mut values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(percentile(&mut values, 0.5), 50.0);
        assert_eq!(percentile(&mut values, 0.99), 99.0);
        assert_eq!(percentile(&mut values, 1.0), 100.0);
        assert!(percentile(&mut [], 0.5).is_nan());
    }
}
