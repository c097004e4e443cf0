use std::path::PathBuf;

use clap::Args;

use crate::arguments::{ModelArguments, SetArguments};
use crate::fail_if::Condition;

/// Arguments of `stgdat bench`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Numbers of agents to measure with; by default 1,16,64,128, and 32 for --jitter
    #[arg(long, value_name = "N,…", value_delimiter = ',',
          value_parser = clap::value_parser!(u16).range(1..=wire::AGENTS_MAX as i64))]
    pub agents: Option<Vec<u16>>,
    /// Number of ticks to measure for each number of agents
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(10..))]
    pub ticks: u64,
    /// Seconds for which the whole pipeline runs at 12.5 Hz; 0 skips it. For --jitter, the seconds of each
    /// row
    #[arg(long, value_name = "S", default_value_t = 20)]
    pub seconds: u64,
    /// Measure the cost of agents and modes instead: 1 to 128 agents with 1, 6 and 20 modes
    #[arg(long, conflicts_with = "agents")]
    pub cost: bool,
    /// Measure how much the times of ticks vary instead, beside a control process with the same wake-ups:
    /// with and without `profile = "vehicle"`, with and without programs that only use CPU time
    #[arg(long, conflicts_with_all = ["cost", "fail_if", "ticks"])]
    pub jitter: bool,
    /// Exit with 70 if this condition holds for the run of --seconds, such as `end_to_end_p99 > 75 ms`. May
    /// be repeated; an unknown name lists all figures
    #[arg(long, value_name = "CONDITION", conflicts_with = "cost")]
    pub fail_if: Vec<Condition>,
    /// Markdown file whose marks `stgdat bench` (`stgdat bench cost`, `stgdat bench jitter`) get the tables,
    /// as the section of this processor
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    #[command(flatten)]
    pub model: ModelArguments,
    #[command(flatten)]
    pub set: SetArguments,
}
