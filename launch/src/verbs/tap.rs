use std::path::PathBuf;

use clap::Args;
use run::Exit;

use console::failure::Failure;
use telemetry::tap;

/// Arguments of `stgdat tap`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The run's record, written by `stgdat run`
    #[arg(long)]
    run: PathBuf,
}

/// Forwards the frames of a run to its tools until the launcher closes standard input.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    tap::serve(&arguments.run)
}
