//! A stage on the tick's path. It reads the tracks and writes tracks in which no agent exceeds a speed limit.
//! (A radar can report such speeds because of wheels and reflections.) The localiser reads these tracks
//! instead. Lines in pipeline.toml:
//!
//! ```toml
//! [[topic]]
//! name = "limited-tracks"
//! type_name = "stgdat.tracks.2"
//! element_bytes = 512
//!
//! [[stage]]
//! name = "speed_limiter"
//! command = ["target/release/examples/speed_limiter"]
//! reads = ["tracks"]
//! writes = ["limited-tracks"]
//! budget_ms = 2
//! options = { speed_max_mps = 40 }
//! ```
//!
//! The table of the localiser also needs `topics = { tracks = "limited-tracks" }`.

use std::process::ExitCode;

use ports::{Answer, NoTopic, Step, Tick, drive, stage_main};
use run::{Conflict, Declaration};
use serde::Deserialize;
use wire::{Rejected, Topic, Track, TracksTopic};

/// The stage's identity comes from pipeline.toml.
const STAGE: Declaration<Options> =
    Declaration::added(&[TracksTopic::NAME], &[LimitedTracks::NAME]).with_rule(Options::check);

/// `options = { … }` in its table of pipeline.toml.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Options {
    /// Highest speed of an agent.
    speed_max_mps: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self { speed_max_mps: 60.0 }
    }
}

impl Options {
    fn check(&self) -> Result<(), Conflict> {
        if self.speed_max_mps > 0.0 {
            return Ok(());
        }
        let (key, reason) = ("speed_max_mps", "`speed_max_mps` is not positive");
        Err(Conflict { key, reason, because: "agents move" })
    }
}

/// The topic: the type of `tracks` under another name.
#[derive(Debug)]
enum LimitedTracks {}

impl Topic for LimitedTracks {
    type Element = Track;
    const NAME: &'static str = "limited-tracks";
    const DOC: &'static str = "The tracks, none of them too fast.";
    const TYPE_NAME: &'static str = TracksTopic::TYPE_NAME;
    const ELEMENTS_MAX: usize = TracksTopic::ELEMENTS_MAX;
    const ELEMENTS_START: usize = TracksTopic::ELEMENTS_START;
}

/// The stage.
struct SpeedLimiter(Options);

impl Step for SpeedLimiter {
    type Input = TracksTopic;
    type Second = NoTopic;
    type Output = LimitedTracks;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic>,
        out: &mut Answer<'_, LimitedTracks>,
    ) -> Result<(), Rejected> {
        let limited = out.elements(tick.input.len())?;
        limited.copy_from_slice(tick.input);
        limited.iter_mut().for_each(|track| limit(track, self.0.speed_max_mps));
        Ok(())
    }
}

/// Scales velocities above the limit down to it.
fn limit(track: &mut Track, most_mps: f32) {
    let factor = |vx_mps: f32, vy_mps: f32| (most_mps / vx_mps.hypot(vy_mps)).min(1.0);
    for state in &mut track.history {
        let factor = factor(state.vx_mps, state.vy_mps);
        (state.vx_mps, state.vy_mps) = (state.vx_mps * factor, state.vy_mps * factor);
    }
    let factor = factor(track.vx_mps, track.vy_mps);
    (track.vx_mps, track.vy_mps) = (track.vx_mps * factor, track.vy_mps * factor);
    track.speed_mps = track.speed_mps.clamp(-most_mps, most_mps);
}

fn main() -> ExitCode {
    stage_main(|run| drive(run, &STAGE, |run| Ok(SpeedLimiter(STAGE.options(run)?))))
}
