use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::{Cause, Forecast, Header, Quality, StageId, Steering, flags};

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
    /// A process was sent a signal or given a limit.
    Signalled {
        /// The process.
        target: String,
        /// What was done.
        what: String,
        /// The newest tick.
        tick: u64,
    },
    /// The verb that replaces a stage has ended.
    Replaced {
        /// The stage.
        stage: String,
        /// Its exit code: 0 where the new process stays.
        exit: i32,
    },
    /// What the run's processes took, now and then.
    Resources {
        /// The newest tick.
        tick: u64,
        /// Resident memory of the launcher.
        launcher_bytes: u64,
        /// Open descriptors of the launcher.
        descriptors: u64,
        /// Resident memory of all stages, what they share counted in each.
        stages_bytes: u64,
        /// The run's files in shared memory and in its folder.
        files: u64,
        /// Bytes in shared memory.
        shared_bytes: u64,
    },
    /// At the end: what the run itself reports, and what it has left.
    Told(Box<Told>),
}

/// The forecasts of one tick as they came.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// The tick.
    pub tick: u64,
    /// Its time of validity.
    pub stamp_ns: i64,
    /// When the source released it, `CLOCK_MONOTONIC`.
    pub released_ns: u64,
    /// When they came, on the same clock.
    pub received_ns: u64,
    /// Whether a stage had refused the tick.
    #[serde(default, skip_serializing_if = "is_default")]
    pub void: bool,
    /// Whether its tracks are predicted.
    #[serde(default, skip_serializing_if = "is_default")]
    pub predicted: bool,
    /// The first number that is not finite or impossible.
    #[serde(default, skip_serializing_if = "is_default")]
    pub impossible: Option<String>,
    /// The incarnations of the stages that the tick has passed.
    pub incarnations: BTreeMap<String, u32>,
    /// The forecasts.
    pub forecasts: Vec<ForecastSeen>,
}

/// What was seen of one forecast.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastSeen {
    /// The track.
    pub id: u64,
    /// `learned`, `held` or `kinematic`.
    pub quality: String,
    /// Why it is not learned; `none` where it says nothing.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub cause: String,
    /// Its age as it says.
    #[serde(default, skip_serializing_if = "is_default")]
    pub age_ns: u64,
    /// Where the agent is.
    pub at_m: [f32; 2],
    /// A number that two forecasts share by the same controls, or by chance; 0 where there are none.
    pub print: u32,
}

/// What a run reports of itself at its end, and what it has left.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Told {
    /// Ticks that it was to have; none for a run that was to end early.
    pub ticks: Option<u64>,
    /// Whether it ran in lockstep.
    pub lockstep: bool,
    /// Greatest age of a held forecast by its policy.
    pub held_max_ns: Option<u64>,
    /// Stages whose restarts are expected: a fault is aimed at them.
    pub targets: Vec<String>,
    /// Restarts of other stages that may be.
    pub restarts_of_others: u64,
    /// Files that may be left.
    pub leftovers: u64,
    /// Whether there is a report: all that follows is from it.
    pub reported: bool,
    /// Deaths of stages after which they were started again.
    pub outages: Vec<Outage>,
    /// Further ones that are only counted.
    pub outages_unlisted: u64,
    /// Frames that never arrived or were refused, by stage.
    pub lost: BTreeMap<String, u64>,
    /// Of these, ticks of which the frame that begins a step is missing, so that nothing was sent for them.
    pub unanswered: BTreeMap<String, u64>,
    /// Forecasts that are not learned, by cause.
    pub causes: BTreeMap<String, u64>,
    /// Ticks that came later than they may.
    pub late_ticks: u64,
    /// Topics that no forecast waits for: what is done to their frames explains nothing.
    pub beside: Vec<String>,
    /// Ticks that the recorder has written and the follower has not seen.
    pub recorded_alone: Vec<u64>,
    /// Files left in shared memory and the run's folder.
    pub files_left: u64,
    /// Stages that were there 2 s after the launcher.
    pub stages_left: u64,
}

/// A death of a stage, as reported.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outage {
    /// The stage.
    pub stage: String,
    /// The newest tick with forecasts when it was noticed.
    pub tick: u64,
    /// Ticks until forecasts were learned again; none where they never were.
    pub ticks_to_learned: Option<u64>,
}

/// Why a history can't be used.
#[derive(Debug, Error)]
pub enum HistoryError {
    /// The file can't be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line is none of a history.
    #[error("{}:{line}: {source}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line's number.
        line: usize,
        /// What is wrong.
        source: serde_json::Error,
    },
}

/// Reads a history.
///
/// # Errors
/// [`HistoryError`] names the file and, for a line that is none, its number.
pub fn read(path: &Path) -> Result<Vec<Line>, HistoryError> {
    let of_file = |source| HistoryError::File { path: path.to_owned(), source };
    let lines = BufReader::new(File::open(path).map_err(of_file)?).lines();
    let parse = |(place, text): (usize, std::io::Result<String>)| {
        let of_line = |source| HistoryError::Line { path: path.to_owned(), line: place + 1, source };
        serde_json::from_str(&text.map_err(of_file)?).map_err(of_line)
    };
    lines.enumerate().map(parse).collect()
}

impl Line {
    /// The forecasts of a tick, where the line has them.
    #[must_use]
    pub const fn output(&self) -> Option<&Output> {
        if let Self::Forecasts(output) = self { Some(output) } else { None }
    }
}

impl Output {
    /// What is seen of a frame.
    #[must_use]
    pub fn of(header: &Header, received_ns: u64, forecasts: &[Forecast]) -> Self {
        let stages = header.hops().iter().filter_map(|hop| {
            let stage = StageId::from_number(hop.stage)?;
            Some((stage.name().to_owned(), hop.incarnation))
        });
        let impossible =
            |forecast: &Forecast| forecast.check().err().map(|why| format!("track {}: {why}", forecast.id));
        Self {
            tick: header.seq,
            stamp_ns: header.stamp_ns,
            released_ns: header.released_ns,
            received_ns,
            void: header.has(flags::VOID),
            predicted: header.has(flags::PREDICTED),
            impossible: forecasts.iter().find_map(impossible),
            incarnations: stages.collect(),
            forecasts: forecasts.iter().map(ForecastSeen::of).collect(),
        }
    }

    /// Forecasts of a quality.
    #[must_use]
    pub fn count(&self, quality: Quality) -> u64 {
        self.forecasts.iter().filter(|forecast| forecast.quality == quality.name()).count() as u64
    }

    /// Forecasts that are not learned, by cause.
    #[must_use]
    pub fn causes(&self) -> BTreeMap<&str, u64> {
        let mut causes = BTreeMap::new();
        for forecast in self.forecasts.iter().filter(|forecast| !forecast.is_learned()) {
            *causes.entry(forecast.cause.as_str()).or_default() += 1;
        }
        causes
    }

    /// Forecasts that are not learned for another cause than a young track or a better expert.
    #[must_use]
    pub fn degraded(&self) -> u64 {
        self.forecasts.iter().filter(|forecast| forecast.is_degraded()).count() as u64
    }

    /// The greatest age of a held forecast.
    #[must_use]
    pub fn age_ms_max(&self) -> f64 {
        let held = self.forecasts.iter().filter(|forecast| forecast.quality == Quality::Held.name());
        held.map(|forecast| forecast.age_ns as f64 / 1e6).fold(0.0, f64::max)
    }

    /// Whether the forecasts are learned again: all but those of young tracks, and one at least.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        let some = self.count(Quality::Learned) > 0 || self.forecasts.is_empty();
        !self.void && !self.predicted && self.degraded() == 0 && some
    }
}

impl ForecastSeen {
    fn of(forecast: &Forecast) -> Self {
        let unknown = |number: u32| format!("number {number}");
        let quality = Quality::from_number(forecast.quality);
        let cause = Cause::from_number(forecast.cause);
        let has_controls = forecast.steering != Steering::None as u32;
        Self {
            id: forecast.id,
            quality: quality.map_or_else(|| unknown(forecast.quality), |quality| quality.name().to_owned()),
            cause: cause.map_or_else(|| unknown(forecast.cause), |cause| cause.name().to_owned()),
            age_ns: forecast.age_ns,
            at_m: [forecast.x_m, forecast.y_m],
            print: if has_controls { print(forecast) } else { 0 },
        }
    }

    /// Whether it says that it is the model's forecast of this tick.
    #[must_use]
    pub fn is_learned(&self) -> bool {
        self.quality == Quality::Learned.name()
    }

    /// Whether the model has forecast in this tick, be it that another expert proved better: what is held later is
    /// the newest of these.
    #[must_use]
    pub fn is_of_the_model(&self) -> bool {
        self.is_learned() || self.cause == Cause::Outdone.name()
    }

    /// Whether it is not learned for another cause than a young track or a better expert.
    #[must_use]
    pub fn is_degraded(&self) -> bool {
        let excused = [Cause::Young, Cause::Outdone].map(Cause::name);
        !self.is_learned() && !excused.contains(&self.cause.as_str())
    }
}

/// FNV-1a of the controls' bits, word by word.
fn print(forecast: &Forecast) -> u32 {
    let words: &[u32] = bytemuck::cast_slice(forecast.controls.as_flattened());
    words.iter().fold(0x811C_9DC5, |hash, word| (hash ^ word).wrapping_mul(0x0100_0193))
}

fn none() -> String {
    Cause::None.name().to_owned()
}

fn is_none(cause: &str) -> bool {
    cause == Cause::None.name()
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
