use std::path::PathBuf;

use clap::Args;

use crate::arguments::{ModelArguments, SetArguments};
use crate::fail_if::Condition;

/// Arguments of `stgdat bench`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Numbers of agents to measure compute with
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_values_t = [1, 16, 64, 128],
          value_parser = clap::value_parser!(u16).range(1..=wire::AGENTS_MAX as i64))]
    pub agents: Vec<u16>,
    /// Measured ticks per number of agents
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..))]
    pub ticks: u64,
    /// Seconds for which the whole pipeline runs at 12.5 Hz; 0 skips it
    #[arg(long, value_name = "S", default_value_t = 20)]
    pub seconds: u64,
    /// Measure what agents and modes cost instead: 1 to 128 agents by 1, 6 and 20 modes
    #[arg(long, conflicts_with = "agents")]
    pub cost: bool,
    /// Fail, with exit code 70, where the run of --seconds has such a figure, as `end_to_end_p99 > 75 ms`;
    /// may be given several times, and a wrong name lists the figures that there are
    #[arg(long, value_name = "CONDITION", conflicts_with = "cost")]
    pub fail_if: Vec<Condition>,
    /// Markdown file whose marks `stgdat bench` (`stgdat bench cost`) get the tables, as the
    /// section of this processor
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArguments,
    #[command(flatten)]
    pub set: SetArguments,
}
