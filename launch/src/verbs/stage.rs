use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValuesParser;
use config::{Exit, Run};
use ports::{RUN_VARIABLE, StageError};
use wire::StageId;

use crate::failure::Failure;

/// Arguments of `stgdat stage`.
#[derive(Debug, Args)]
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
        .ok_or_else(|| Failure::Usage(format!("there is no stage \"{}\"", arguments.name)))?;
    let run = Run::read(&arguments.run).map_err(StageError::config)?;
    let body = match stage {
        StageId::Source => source::stage::run,
        StageId::Tracker => tracker::stage::run,
        StageId::Localiser => localiser::stage::run,
        StageId::Extractor => extractor::stage::run,
        StageId::Encoder => encoder::stage::run,
        StageId::Decoder => decoder::stage::run,
        StageId::Sampler => sampler::stage::run,
        StageId::Recorder => recorder::stage::run,
    };
    body(&run)?;
    Ok(Exit::Done)
}
