use std::path::PathBuf;

use clap::Args;
use console::failure::Failure;
use console::say;
use data::Recording;
use drawing::{NoisyTrack, noisy_track};
use evaluator::{Noise, SEED, Truth};
use launch::arguments::ReadArguments;
use metrics::Point;
use nn::{ModelConfig, Weights};
use onboard::Chain;
use run::{Exit, Run};
use source::{Playback, PlaybackOptions};
use wire::Forecast;

use crate::picture::save;

/// Time between two drawn true positions.
const TRUTH_NS: i64 = 100_000_000;

/// Arguments of `stgdat plot track`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording with identities, which is played through the stages with the embedded weights
    recording: PathBuf,
    #[command(flatten)]
    read: ReadArguments,
    /// The agent, by its identity in the recording
    #[arg(long, value_name = "ID")]
    agent: u64,
    /// Time of the forecast, in seconds from the first tick
    #[arg(long, value_name = "SECONDS")]
    at: f64,
    /// Time before the forecast that is shown, s
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    past: f64,
    /// Noise that is added to the positions: standard deviation per axis, m
    #[arg(long, value_name = "M", default_value_t = 0.3)]
    noise: f64,
    /// Leave out reported headings and speeds
    #[arg(long)]
    positions: bool,
    /// Output file, .svg or .png
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Width of the picture in points
    #[arg(long, value_name = "PT", default_value_t = 516.0)]
    width: f64,
    /// Height of the panel relative to its width
    #[arg(long, value_name = "RATIO", default_value_t = 0.6)]
    ratio: f64,
}

/// Draws an agent of a recording that a noisy sensor sees.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if !(0.0..=10.0).contains(&arguments.noise) {
        return Err(Failure::Usage(format!("--noise {}: expected a number from 0 to 10", arguments.noise)));
    }
    let recording = arguments.read.open(&arguments.recording)?;
    let truth = Truth::of(&recording);
    if !recording.has_identities || truth.tracks().all(|track| track.id != arguments.agent) {
        let why = format!("no identity {}", arguments.agent);
        return Err(Failure::file(&arguments.recording, why));
    }
    let noise = Noise {
        sigma_m: arguments.noise,
        positions_only: arguments.positions,
        seed: SEED,
        ..Noise::default()
    };
    let weights = Weights::onboard();
    let mut drawing = arguments.play(noise.applied_to(&recording), &truth, weights.config())?;
    drawing.title = format!("{}, agent {}", recording.name, arguments.agent);
    drawing.note = format!("noise of {} m; forecast at {} s", arguments.noise, arguments.at);
    let picture = noisy_track(&drawing, arguments.width, arguments.ratio).map_err(Failure::data)?;
    save(&picture, &arguments.out)?;
    say!("{}", arguments.out.display());
    Ok(Exit::Done)
}

impl Arguments {
    /// Plays the noisy recording up to the forecast.
    fn play(&self, noisy: Recording, truth: &Truth, model: &ModelConfig) -> Result<NoisyTrack, Failure> {
        let mut playback =
            Playback::new(noisy, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() });
        let run = Run { lockstep: true, interval_ns: playback.interval_ns(), ..Run::default() };
        let mut chain = Chain::new(&run, model)?;
        let mut drawing = NoisyTrack::default();
        let (mut first_ns, mut newest) = (None, None);
        while let Some(tick) = playback.next_tick() {
            let stamp_ns = tick.header.stamp_ns;
            let time_s = (stamp_ns - *first_ns.get_or_insert(stamp_ns)) as f64 * 1e-9;
            if time_s > self.at + 1e-6 {
                break;
            }
            let is_shown = time_s >= self.at - self.past - 1e-6;
            if is_shown {
                let own = tick.detections.iter().filter(|detection| detection.id == self.agent);
                drawing.detections.extend(own.map(|detection| [detection.x_m, detection.y_m]));
            }
            let (_, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
            let own = forecasts.iter().find(|forecast| forecast.source_id == self.agent);
            if let Some(forecast) = own.filter(|_| is_shown) {
                drawing.track.push([forecast.x_m, forecast.y_m]);
            }
            newest = own.map(|forecast| (stamp_ns, *forecast));
        }
        let (now_ns, forecast) = newest.ok_or_else(|| {
            let agent = self.agent;
            Failure::file(&self.recording, format!("agent {agent} has no forecast at {} s", self.at))
        })?;
        let len = model.horizon_len;
        drawing.best = forecast.best[..len].to_vec();
        drawing.modes = modes(&forecast, len);
        let end_ns = now_ns + len as i64 * model.step_ns().cast_signed();
        let from_ns = now_ns - (self.past * 1e9) as i64;
        let times = (0..).map(|step| from_ns + step * TRUTH_NS).take_while(|at_ns| *at_ns <= end_ns);
        drawing.truth = times.filter_map(|at_ns| Some(truth.state(self.agent, at_ns)?.position_m)).collect();
        Ok(drawing)
    }
}

fn modes(forecast: &Forecast, len: usize) -> Vec<Vec<Point>> {
    let modes = &forecast.modes[..forecast.modes_len as usize];
    modes.iter().map(|mode| mode[..len].to_vec()).collect()
}
