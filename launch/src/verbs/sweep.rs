use std::path::PathBuf;

use clap::Args;
use run::{Exit, Run};

use crate::failure::Failure;

/// Arguments of `stgdat sweep`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The run's record, written by `stgdat run`
    #[arg(long)]
    run: PathBuf,
}

/// Gives back what dead stages of a living run held; the launcher starts it, with a time limit.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = Run::read(&arguments.run).map_err(Failure::config)?;
    ports::clean_dead_nodes(&run)?;
    Ok(Exit::Done)
}
