mod chain;
mod pipe;
mod stages;
mod work;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use nn::kernels;
use run::Exit;

use crate::arguments::{ModelArguments, SetArguments};
use crate::failure::Failure;
use crate::tables;

/// Time for measuring each of the machine's peaks.
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
    /// Markdown file whose marks `stgdat bench` get the tables
    #[arg(long, alias = "readme", value_name = "FILE")]
    table: Option<PathBuf>,
    #[command(flatten)]
    model: ModelArguments,
    #[command(flatten)]
    set: SetArguments,
}

/// Measures compute per stage, the overhead of the pipeline and this machine's peaks, in one run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let peak = kernels::peak::product_gflops(PEAK_TIME);
    let mut text = format!(
        "{} kernels, {} cores; matrix product {peak:.0} GFLOP/s and multiply-adds in registers {:.0} GFLOP/s on one \
         thread.\n\n",
        kernels::active().name(),
        std::thread::available_parallelism().map_or(1, usize::from),
        kernels::peak::fma_gflops(PEAK_TIME),
    );
    text += &stages::table(arguments, peak)?;
    if arguments.seconds > 0 {
        text += &chain::table(&arguments.model, &arguments.set, arguments.seconds)?;
    }
    print!("{text}");
    if let Some(path) = &arguments.table {
        tables::replace(path, "bench", &text)?;
    }
    Ok(Exit::Done)
}

/// The quantile `share` of `values`, by nearest rank.
fn percentile(values: &mut [f64], share: f64) -> f64 {
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
