//! Predicts whether a number of agents fits this machine, from one or two seconds of computation.
//!
//! All stages run in this process on one thread, with the generated scene of the default demo. Three rules
//! extrapolate the time of a tick in a run. They held within about a third on the measured machines.
//!
//! - Workers share blocks evenly.
//! - The 99th percentile of the tick time is 1.4 times the median.
//! - The time grows slightly faster than the number of agents, because of their edges.

use std::time::{Duration, Instant};

use data::{GeneratedScene, SceneOptions};
use nn::Weights;
use onboard::Chain;
use run::Run;
use source::{Playback, PlaybackOptions};
use wire::{AGENTS_MAX, StageId};

use configuration::options::{Setting, StageOptions};
use console::failure::Failure;

/// Agents of the default demo, used for the measurement.
pub const AGENTS: u32 = 32;
/// Ticks until the history of most agents is full.
const WARM_UP: u64 = 45;
/// Maximum number of measured ticks.
const TICKS: u64 = 40;
/// Maximum time of the measurement, including the warm-up.
const TIME: Duration = Duration::from_secs(2);
/// Minimum number of measured ticks, however long they take.
const TICKS_MIN: usize = 5;
/// Stages that distribute their work over workers.
pub const SHARED: [StageId; 4] = [StageId::Extractor, StageId::Encoder, StageId::Decoder, StageId::Sampler];
/// Exponent with which the time of a tick grows with the number of agents.
const GROWTH: f64 = 1.05;
/// Ratio of the 99th percentile to the median, for the ticks of a run on an idle machine.
const TAIL: f64 = 1.4;
/// Time to wake eight processes.
const OVERHEAD_MS: f64 = 0.7;
/// Time from a tick's release until its forecasts are due: the sampler's deadline in the shipped
/// pipeline.toml.
pub const LIMIT_MS: f64 = 72.0;

/// Measured time of a tick with [`AGENTS`] agents: median in ms on one thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Time in stages that distribute their work.
    shared_ms: f64,
    /// Time in all other stages.
    alone_ms: f64,
    workers: usize,
}

impl Prediction {
    /// Measures this machine under its current load.
    ///
    /// # Errors
    /// [`Failure`] if the scene or the embedded weights can't be used.
    pub fn measure() -> Result<Self, Failure> {
        let scene = SceneOptions { agents: AGENTS as usize, ..SceneOptions::default() };
        let scene = GeneratedScene::new(scene).map_err(Failure::data)?;
        let recording = scene.recording((WARM_UP + TICKS) as usize);
        let mut playback = Playback::new(recording, PlaybackOptions { lockstep: true, ..Default::default() });
        let weights = Weights::onboard();
        let mut options = StageOptions::defaults(&StageId::ALL);
        options.apply(&SHARED.map(|stage| Setting::of_flag("doctor", stage, "workers", 1)))?;
        let run = Run {
            interval_ns: playback.interval_ns(),
            lockstep: true,
            stages: options.stage_runs(),
            ..Run::default()
        };
        let mut chain = Chain::new(&run, weights.config())?;
        let (begun, mut times_ms) = (Instant::now(), Vec::new());
        while let Some(tick) = playback.next_tick() {
            let (mut last, mut of_tick) = (Instant::now(), [0.0; 2]);
            chain.tick(&tick.header, tick.detections, |stage| {
                let now = Instant::now();
                of_tick[usize::from(SHARED.contains(&stage))] += (now - last).as_secs_f64() * 1e3;
                last = now;
            });
            if tick.header.seq >= WARM_UP {
                times_ms.push(of_tick);
            }
            if begun.elapsed() > TIME && times_ms.len() >= TICKS_MIN {
                break;
            }
        }
        let [alone_ms, shared_ms] = [0, 1].map(|part| median(times_ms.iter().map(|times| times[part])));
        Ok(Self { shared_ms, alone_ms, workers: nn::default_workers() })
    }

    /// Predicted time from a tick's release to its forecasts: median and 99th percentile, ms.
    pub fn tick_ms(&self, agents: u32) -> [f64; 2] {
        let growth = (f64::from(agents) / f64::from(AGENTS)).powf(GROWTH);
        let p50 = (self.alone_ms + self.shared_ms / self.workers as f64) * growth + OVERHEAD_MS;
        [p50, p50 * TAIL]
    }

    /// Whether this number of agents fits.
    pub fn fits(&self, agents: u32) -> bool {
        self.tick_ms(agents)[1] <= LIMIT_MS
    }

    /// Returns the maximum number of agents that fit; 0 if not even one does.
    pub fn agents_max(&self) -> u32 {
        (1..=AGENTS_MAX as u32).rev().find(|&agents| self.fits(agents)).unwrap_or(0)
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_share_what_can_be_shared() {
        let on = |workers| Prediction { shared_ms: 20.0, alone_ms: 2.0, workers };
        assert!((on(1).tick_ms(AGENTS)[0] - 22.7).abs() < 1e-9);
        assert!((on(2).tick_ms(AGENTS)[0] - 12.7).abs() < 1e-9);
        assert!(on(2).fits(AGENTS) && !on(1).fits(128));
        assert!(on(2).agents_max() > on(1).agents_max());
        let slow = Prediction { shared_ms: 4e3, alone_ms: 50.0, workers: 1 };
        assert_eq!((slow.fits(AGENTS), slow.agents_max()), (false, 0));
    }

    #[test]
    fn more_agents_take_more_than_their_share() {
        let machine = Prediction { shared_ms: 9.0, alone_ms: 1.0, workers: 1 };
        let [few, many] = [AGENTS, 4 * AGENTS].map(|agents| machine.tick_ms(agents)[0] - OVERHEAD_MS);
        assert!(many > 4.0 * few && many < 4.5 * few, "{few} {many}");
    }

    #[test]
    fn this_machine_can_be_measured() {
        let machine = Prediction::measure().unwrap();
        assert!(machine.shared_ms > 0.0 && machine.alone_ms > 0.0, "{machine:?}");
    }
}
