mod scene;
mod track;
mod training;

use clap::{Args, Subcommand};
use run::Exit;

use console::failure::Failure;

/// Arguments of `stgdat plot`.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Plot scenes of a recording with their forecasts
    Scene(Box<scene::Arguments>),
    /// Plot one agent of a recording under noise: detections, track, forecast and true motion
    Track(track::Arguments),
    /// Plot the learning curves of a training
    Training(training::Arguments),
}

/// Draws a picture.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    match &arguments.what {
        What::Scene(arguments) => scene::execute(arguments),
        What::Track(arguments) => track::execute(arguments),
        What::Training(arguments) => training::execute(arguments),
    }
}
