use std::path::PathBuf;

use clap::Args;
use run::{Exit, Run};
use supervisor::helper_line;

use console::failure::Failure;
use console::say;

/// Arguments of `stgdat sweep`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The run's record, written by `stgdat run`
    #[arg(long)]
    run: PathBuf,
}

/// Releases the resources that dead processes of a living run held, and prints one line per process. The
/// launcher starts this verb, with a time limit.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = Run::read(&arguments.run).map_err(Failure::config)?;
    ports::clean_dead_nodes(&run, |number, process| say!("{}", helper_line(number, process)))?;
    Ok(Exit::Done)
}
