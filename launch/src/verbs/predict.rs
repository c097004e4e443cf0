use std::io::ErrorKind;
use std::path::PathBuf;

use clap::Args;
use config::{Exit, MapChoice, Run, Scene};
use data::Format;
use recorder::ForecastWriter;
use source::{Playback, PlaybackOptions};

use crate::arguments::{ModelArguments, TrackerArguments};
use crate::chain::Chain;
use crate::failure::Failure;

/// Arguments of `stgdat predict`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The recording
    recording: PathBuf,
    /// The recording's format; found out where not given
    #[arg(long)]
    format: Option<Format>,
    /// Where the forecasts go, a line of JSON per tick; `-` for standard output
    #[arg(long, value_name = "FILE", default_value = "-")]
    out: PathBuf,
    /// Seed of all that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// End after so many ticks
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    ticks: Option<u64>,
    #[command(flatten)]
    tracker: TrackerArguments,
    #[command(flatten)]
    model: ModelArguments,
}

/// Runs a recording through all stages in this process.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (weights_path, weights) = arguments.model.open_weights(None)?;
    let path = &arguments.recording;
    let path = path.canonicalize().map_err(|error| Failure::file(path, &error))?;
    let scene = Scene::Recording { path, format: arguments.format.map(|format| format.name().to_owned()) };
    let recording = source::recording(&scene, arguments.seed, arguments.ticks)?;
    let options = PlaybackOptions { run_id: 0, ticks_max: arguments.ticks, lockstep: true };
    let mut playback = Playback::new(recording, options);
    let mut chain = Chain::new(&Run {
        interval_ns: playback.interval_ns(),
        lockstep: true,
        seed: arguments.seed,
        scene,
        ticks: arguments.ticks,
        associate: arguments.tracker.associate,
        prior: arguments.tracker.prior.unwrap_or_default(),
        weights: weights_path,
        model: weights.config().clone(),
        map: arguments.model.map.clone().unwrap_or(MapChoice::Online),
        ..Run::default()
    })?;
    let standard_output = arguments.out.as_os_str() == "-";
    let out = if standard_output { "/dev/stdout".into() } else { arguments.out.clone() };
    let written = |error: std::io::Error| Failure::file(&out, &error);
    let mut writer = ForecastWriter::create(&out).map_err(written)?;
    let (mut ticks, mut forecasts_len) = (0_u64, 0_u64);
    while let Some(tick) = playback.next_tick() {
        let (header, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        match writer.write(&header, forecasts) {
            // The reader of a pipe has seen enough.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(Exit::Done),
            result => result.map_err(written)?,
        }
        ticks += 1;
        forecasts_len += forecasts.len() as u64;
    }
    writer.finish().map_err(written)?;
    if !standard_output {
        println!("{ticks} ticks, {forecasts_len} forecasts: {}", out.display());
    }
    Ok(Exit::Done)
}
