mod new;
mod replace;

use std::path::PathBuf;

use clap::{Args, Subcommand};
use ports::{RUN_VARIABLE, StageError};
use run::{Exit, Run};
use wire::StageId;

use configuration::stages;
use console::failure::Failure;

/// Arguments of `stgdat stage`.
#[derive(Debug, Args)]
#[command(
    after_long_help = stages::options_help(),
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Option<Verb>,
    /// The stage
    #[arg(value_parser = stages::names(), required = true)]
    name: Option<String>,
    /// The run's record, written by `stgdat run`
    #[arg(long, env = RUN_VARIABLE, required = true)]
    run: Option<PathBuf>,
}

/// The verbs of `stgdat stage`.
#[derive(Debug, Subcommand)]
enum Verb {
    /// Write a cargo project of a stage, or of another program that joins runs
    New(new::Arguments),
    /// Replace a stage of a running pipeline between two ticks
    Replace(replace::Arguments),
}

/// Runs one stage of a run until the process is asked to end, as the stage's own program does.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    match (&arguments.verb, &arguments.name, &arguments.run) {
        (Some(Verb::New(arguments)), ..) => new::execute(arguments),
        (Some(Verb::Replace(arguments)), ..) => replace::execute(arguments),
        (None, Some(name), Some(record)) => {
            ports::die_with_launcher()?;
            let stage = StageId::from_name(name)
                .and_then(stages::built_in)
                .ok_or_else(|| Failure::Usage(format!("there is no stage \"{name}\"")))?;
            let run = Run::read(record).map_err(StageError::config)?;
            (stage.body)(&run)?;
            Ok(Exit::Done)
        }
        (None, ..) => Err(Failure::Usage("needs the name of a stage and the run's record".to_owned())),
    }
}
