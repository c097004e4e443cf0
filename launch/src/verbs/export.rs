use std::path::PathBuf;

use clap::Args;
use console::failure::Failure;
use console::say;
use recording::{About, EVENTS, NO_TOPIC};
use run::Exit;
use wire::{ForecastsTopic, Topic as _, TracksTopic};

use crate::files::check_new;
use crate::recorded;
use crate::view_arguments::ViewArguments;

/// Arguments of `stgdat export`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording of a run, as `run --record` and `record` write them
    #[arg(value_name = "RUN")]
    recording: PathBuf,
    /// File to write
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Replace the file if it exists
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    view: ViewArguments,
}

/// Writes the messages of a recorded run that other tools read.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let Arguments { recording, file, force, view } = arguments;
    if view.is_empty() {
        return Err(Failure::Usage("--for names the tools: foxglove, autoware".to_owned()));
    }
    check_new(file, *force)?;
    let recording = recorded::open(recording)?;
    if file.is_file() {
        if file.canonicalize().ok() == recording.path().canonicalize().ok() {
            return Err(Failure::file(file, "the recording can't be exported to itself"));
        }
        std::fs::remove_file(file).map_err(|error| Failure::file(file, error))?;
    }
    for topic in [TracksTopic::NAME, ForecastsTopic::NAME] {
        if !recording.has_topic(topic) {
            let why = format!("it has no {topic}, which the messages are made of");
            return Err(Failure::data_about(recording.path().display(), why));
        }
    }
    // The frames themselves stay in the recording, and so do events if the tools of ROS cannot decode them.
    let topic = if view.is_for_ros() { NO_TOPIC } else { EVENTS };
    let about = About { topics: vec![topic.to_owned()], before: false, ..recording.about().clone() };
    let mut writer = view.create(file, &about).map_err(Failure::data)?;
    let mut damages = Vec::new();
    for message in recording.messages() {
        match message {
            Ok(message) => writer.add(&message),
            Err(error) => damages.push(error),
        }
    }
    let written = writer.finish("exported").map_err(Failure::data)?;
    let topics: Vec<String> = written.by_topic.iter().map(|(name, len)| format!("{len} {name}")).collect();
    say!("{}: {:.1} MB; {}", file.display(), written.bytes as f64 / 1e6, topics.join(", "));
    if !written.lost.is_empty() {
        return Err(Failure::Failed(format!("{}: not written: {:?}", file.display(), written.lost)));
    }
    recorded::end_with(damages)
}
