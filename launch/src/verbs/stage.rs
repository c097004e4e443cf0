use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValuesParser;
use ports::{RUN_VARIABLE, StageError};
use run::{Exit, Run};
use wire::StageId;

use crate::failure::Failure;
use crate::stages;

/// Arguments of `stgdat stage`.
#[derive(Debug, Args)]
#[command(after_long_help = stages::options_help())]
pub struct Arguments {
    /// The stage
    #[arg(value_parser = PossibleValuesParser::new(StageId::ALL.map(StageId::name)))]
    name: String,
    /// The run's record, written by `stgdat run`
    #[arg(long, env = RUN_VARIABLE)]
    run: PathBuf,
}

/// Runs one stage of a run until it is asked to end, as the stage's own program does.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    ports::die_with_launcher()?;
    let stage = StageId::from_name(&arguments.name)
        .and_then(stages::built_in)
        .ok_or_else(|| Failure::Usage(format!("there is no stage \"{}\"", arguments.name)))?;
    let run = Run::read(&arguments.run).map_err(StageError::config)?;
    (stage.body)(&run)?;
    Ok(Exit::Done)
}
