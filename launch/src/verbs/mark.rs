use std::path::PathBuf;

use clap::Args;
use recording::tap::{Client, Request};
use run::Exit;

use crate::failure::Failure;
use crate::runs;

/// Arguments of `stgdat mark`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Words for this moment
    #[arg(value_name = "TEXT")]
    text: String,
    /// The run, by its name or its folder, where more than one goes on
    #[arg(long, value_name = "NAME")]
    run: Option<PathBuf>,
}

/// Marks this moment in all recordings of a run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let mark = Some(arguments.text.clone());
    let request = Request { tool: "mark".to_owned(), topics: Vec::new(), events: false, mark };
    Client::attach(&run.root, &request).map_err(Failure::unavailable)?;
    Ok(Exit::Done)
}
