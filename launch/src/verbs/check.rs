use std::path::PathBuf;

use crate::config::BUDGET_MAX_MS;
use clap::Args;
use run::Exit;

use crate::failure::Failure;
use crate::pipeline_file;

/// Arguments of `stgdat check`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The pipeline.toml; by default the built-in one
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The same, as `run` takes it
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    pipeline: Option<PathBuf>,
}

/// Checks a pipeline.toml and prints a summary.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let path = arguments.file.as_deref().or(arguments.pipeline.as_deref());
    let pipeline = pipeline_file::load(path)?;
    pipeline_file::check_here(path)?;
    let own = pipeline.stages.iter().filter(|stage| stage.command.is_some()).count();
    say!(
        "ok: {} stages ({own} external), {} connections, budgets {} of {BUDGET_MAX_MS} ms",
        pipeline.stages.len(),
        pipeline.edges().len(),
        pipeline.budget_ms
    );
    Ok(Exit::Done)
}
