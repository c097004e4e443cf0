use std::path::PathBuf;

use crate::picture::save;
use clap::Args;
use drawing::{TrainingLog, learning_curves};
use run::Exit;

use console::failure::Failure;
use console::say;

/// Arguments of `stgdat plot training`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Log that `stgdat train` writes beside its checkpoints
    #[arg(value_name = "LOG.jsonl")]
    log: PathBuf,
    /// Output file, .svg or .png
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Title; by default the name of the log's folder
    #[arg(long)]
    title: Option<String>,
}

/// Draws the learning curves of a training.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let path = arguments.log.canonicalize().map_err(|error| Failure::file(&arguments.log, error))?;
    let log = TrainingLog::read(&path).map_err(Failure::data)?;
    let folder = path.parent().and_then(|folder| folder.file_name());
    let title = arguments.title.clone().or_else(|| Some(folder?.to_string_lossy().into_owned()));
    let picture = learning_curves(&log, title.as_deref().unwrap_or("Training")).map_err(Failure::data)?;
    save(&picture, &arguments.out)?;
    say!("{}", arguments.out.display());
    Ok(Exit::Done)
}
