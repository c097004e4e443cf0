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
    /// Which stage
    #[arg(value_parser = PossibleValuesParser::new(StageId::ALL.map(StageId::name)))]
    name: String,
    /// The run's record, which `stgdat run` writes
    #[arg(long, env = RUN_VARIABLE)]
    run: PathBuf,
}

/// Is one stage of a run until told to end; the same as the stage's own program.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    ports::die_with_launcher()?;
    let stage = StageId::from_name(&arguments.name)
        .and_then(stages::built_in)
        .ok_or_else(|| Failure::Usage(format!("there is no stage \"{}\"", arguments.name)))?;
    let run = Run::read(&arguments.run).map_err(StageError::config)?;
    (stage.body)(&run)?;
    Ok(Exit::Done)
}
