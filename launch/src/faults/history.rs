//! The history of a run: a line of JSON for each thing that the follower and the injectors saw.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Cause, Forecast, Header, Quality, StageId, flags};

/// One line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Line {
    /// The forecasts of a tick have come.
    Forecasts(Output),
    /// The source has released a tick, or a stage has finished one: by a heartbeat.
    Reached {
        /// The stage.
        stage: String,
        /// The tick.
        tick: u64,
        /// How often the stage had been started before.
        incarnation: u32,
    },
    /// Faults acted on a frame.
    Injected {
        /// The topic.
        topic: String,
        /// The tick.
        tick: u64,
        /// The kinds of the faults.
        kinds: Vec<String>,
    },
    /// What an injector cost.
    Cost {
        /// The topic.
        topic: String,
        /// Frames that came through it.
        frames: u64,
        /// Median of the time that it had a frame in hand, without a delay that was injected.
        us_p50: u64,
        /// The longest time.
        us_max: u64,
    },
    /// The verb that replaces a stage has ended.
    Replaced {
        /// The stage.
        stage: String,
        /// Its exit code: 0 where the new process stays.
        exit: i32,
    },
    /// A process was sent a signal or given a limit.
    Signalled {
        /// The process.
        target: String,
        /// What was done.
        what: String,
        /// The newest tick.
        tick: u64,
    },
}

/// The forecasts of one tick, summed up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// The tick.
    pub tick: u64,
    /// Its time of validity.
    pub stamp_ns: i64,
    /// When they came, `CLOCK_MONOTONIC`.
    pub received_ns: u64,
    /// Whether a stage had refused the tick.
    pub void: bool,
    /// Whether its tracks are predicted.
    pub predicted: bool,
    /// Forecasts by quality: learned, held, kinematic.
    pub qualities: [u64; 3],
    /// Forecasts that are not learned for another cause than a young track or a better expert.
    pub degraded: u64,
    /// Forecasts that are not learned, by cause.
    pub causes: BTreeMap<String, u64>,
    /// Forecasts that are not learned and have no cause.
    pub uncaused: u64,
    /// Learned forecasts with an age, and held ones without.
    pub wrong_age: u64,
    /// The greatest age of a held forecast.
    pub age_ms_max: f64,
    /// The first number that is not finite or impossible.
    pub impossible: Option<String>,
    /// The incarnations of the stages that the tick has passed.
    pub incarnations: BTreeMap<String, u32>,
}

impl Line {
    /// The forecasts of a tick, where the line has them.
    pub const fn output(&self) -> Option<&Output> {
        if let Self::Forecasts(output) = self { Some(output) } else { None }
    }
}

impl Output {
    /// Sums up a frame.
    pub fn of(header: &Header, received_ns: u64, forecasts: &[Forecast]) -> Self {
        let mut output = Self {
            tick: header.seq,
            stamp_ns: header.stamp_ns,
            received_ns,
            void: header.has(flags::VOID),
            predicted: header.has(flags::PREDICTED),
            ..Self::default()
        };
        for hop in header.hops() {
            if let Some(stage) = StageId::from_number(hop.stage) {
                output.incarnations.insert(stage.name().to_owned(), hop.incarnation);
            }
        }
        for forecast in forecasts {
            output.add(forecast);
        }
        output
    }

    fn add(&mut self, forecast: &Forecast) {
        if let Err(why) = forecast.check() {
            self.impossible.get_or_insert_with(|| format!("track {}: {why}", forecast.id));
        }
        let quality = Quality::from_number(forecast.quality).unwrap_or(Quality::Kinematic);
        self.qualities[quality as usize] += 1;
        let age_ms = forecast.age_ns as f64 / 1e6;
        self.wrong_age += u64::from(match quality {
            Quality::Learned => forecast.age_ns != 0,
            Quality::Held => forecast.age_ns == 0,
            Quality::Kinematic => false,
        });
        if quality == Quality::Learned {
            return;
        }
        if quality == Quality::Held {
            self.age_ms_max = self.age_ms_max.max(age_ms);
        }
        let cause = Cause::from_number(forecast.cause);
        self.uncaused += u64::from(cause.is_none_or(|cause| cause == Cause::None));
        self.degraded += u64::from(!matches!(cause, Some(Cause::Young | Cause::Outdone)));
        let name =
            cause.map_or_else(|| format!("number {}", forecast.cause), |cause| cause.name().to_owned());
        *self.causes.entry(name).or_default() += 1;
    }

    /// Whether the forecasts are learned again: all but those of young tracks, and one at least.
    pub fn is_learned(&self) -> bool {
        let some = self.qualities[0] > 0 || self.qualities == [0; 3];
        !self.void && !self.predicted && self.degraded == 0 && some
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn forecasts_are_summed_up_by_quality_and_cause() {
        let forecast = |quality: Quality, cause: Cause, age_ns| Forecast {
            quality: quality as u32,
            cause: cause as u32,
            age_ns,
            ..Forecast::zeroed()
        };
        let learned = forecast(Quality::Learned, Cause::None, 0);
        let held = forecast(Quality::Held, Cause::Late, 160_000_000);
        let header = Header::new(1, 5, 0);
        assert!(Output::of(&header, 0, &[learned]).is_learned());
        let output = Output::of(&header, 0, &[learned, held, forecast(Quality::Kinematic, Cause::None, 0)]);
        assert_eq!((output.qualities, output.degraded, output.uncaused), ([1, 1, 1], 2, 1));
        assert_eq!((output.age_ms_max, output.causes["late"], output.is_learned()), (160.0, 1, false));
        let lies = [forecast(Quality::Learned, Cause::None, 80), forecast(Quality::Held, Cause::Late, 0)];
        assert_eq!(Output::of(&header, 0, &lies).wrong_age, 2);
        let nowhere = Forecast { x_m: f32::NAN, ..learned };
        assert!(Output::of(&header, 0, &[nowhere]).impossible.is_some());
    }
}
