use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::{Cause, Forecast, Header, Quality, StageId, Steering, flags};

/// One line of a history.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Line {
    /// The forecasts of a tick have arrived.
    Forecasts(Output),
    /// The source has released a tick, or a stage has finished one, according to a heartbeat.
    Reached {
        stage: String,
        tick: u64,
        /// Number of earlier starts of the stage.
        incarnation: u32,
    },
    /// Faults acted on a frame.
    Injected {
        topic: String,
        tick: u64,
        /// The kinds of the faults.
        kinds: Vec<String>,
    },
    /// The cost of an injector.
    Cost {
        topic: String,
        /// Number of frames that passed through it.
        frames: u64,
        /// Median time that the injector held a frame, without an injected delay.
        us_p50: u64,
        /// The longest such time.
        us_max: u64,
    },
    /// A process received a signal or a limit.
    Signalled {
        target: String,
        /// The signal or limit.
        what: String,
        /// The newest tick.
        tick: u64,
    },
    /// The command that replaces a stage has ended.
    Replaced {
        stage: String,
        /// Exit code: 0 if the new process stays.
        exit: i32,
    },
    /// The resources of the run's processes, sampled now and then.
    Resources {
        /// The newest tick.
        tick: u64,
        /// Resident memory of the launcher.
        launcher_bytes: u64,
        /// Open descriptors of the launcher.
        descriptors: u64,
        /// Resident memory of all stages. Shared memory counts in each of them.
        stages_bytes: u64,
        /// The run's files in shared memory and in its folder.
        files: u64,
        /// Bytes in shared memory.
        shared_bytes: u64,
    },
    /// The run's own report at its end, and what the run has left behind.
    Facts(Box<Facts>),
}

/// The observed forecasts of one tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Output {
    pub tick: u64,
    /// Time of validity.
    pub stamp_ns: i64,
    /// Release time at the source, `CLOCK_MONOTONIC`.
    pub released_ns: u64,
    /// Arrival time, on the same clock.
    pub received_ns: u64,
    /// Whether a stage had refused the tick.
    #[serde(default, skip_serializing_if = "is_default")]
    pub void: bool,
    /// Whether its tracks are predicted.
    #[serde(default, skip_serializing_if = "is_default")]
    pub predicted: bool,
    /// Whether it begins a session, in which stamps may be older.
    #[serde(default, skip_serializing_if = "is_default")]
    pub new_session: bool,
    /// The first number that is not finite or is impossible.
    #[serde(default, skip_serializing_if = "is_default")]
    pub impossible: Option<String>,
    /// The incarnations of the stages that the tick has passed through.
    pub incarnations: BTreeMap<String, u32>,
    pub forecasts: Vec<ForecastSeen>,
}

/// One observed forecast.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastSeen {
    pub id: u64,
    /// `learned`, `held` or `kinematic`.
    pub quality: String,
    /// Why it is not learned; `none` if no cause is given.
    #[serde(default = "none", skip_serializing_if = "is_none")]
    pub cause: String,
    /// Stated age.
    #[serde(default, skip_serializing_if = "is_default")]
    pub age_ns: u64,
    /// Position of the agent.
    pub at_m: [f32; 2],
    /// A hash of the controls; 0 if there are no controls. Equal hashes mean equal controls, except by
    /// chance.
    pub print: u32,
}

/// A run's own report at its end, and what the run has left behind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Facts {
    /// Planned number of ticks; `None` for a run that was to end early.
    pub ticks: Option<u64>,
    /// Whether it ran in lockstep.
    pub lockstep: bool,
    /// Maximum age of a held forecast according to its policy.
    pub held_max_ns: Option<u64>,
    /// Stages that are the target of a fault, so their restarts are expected.
    pub targets: Vec<String>,
    /// Number of allowed restarts of other stages.
    pub restarts_of_others: u64,
    /// Number of files that may be left.
    pub leftovers: u64,
    /// Whether there is a report. All fields below come from it.
    pub reported: bool,
    /// Deaths of stages that were followed by a restart.
    pub outages: Vec<Outage>,
    /// Number of further outages without details.
    pub outages_unlisted: u64,
    /// Frames that never arrived or were refused, by stage.
    pub lost: BTreeMap<String, u64>,
    /// Ticks without an answer, by stage: the frame that begins a step was lost. They are included in `lost`.
    pub unanswered: BTreeMap<String, u64>,
    /// Number of forecasts that are not learned, by cause.
    pub causes: BTreeMap<String, u64>,
    /// Number of ticks that arrived too late.
    pub late_ticks: u64,
    /// Topics that no forecast waits for. A fault on their frames explains nothing.
    pub off_path_topics: Vec<String>,
    /// Ticks that the recorder has written but the follower has not seen.
    pub recorded_alone: Vec<u64>,
    /// Number of files left in shared memory and the run's folder.
    pub files_left: u64,
    /// Number of stages that still ran 2 s after the launcher had ended.
    pub stages_left: u64,
}

/// A reported death of a stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outage {
    pub stage: String,
    /// The newest tick with forecasts when the death was noticed.
    pub tick: u64,
    /// Ticks until forecasts were learned again; `None` if they never were.
    pub ticks_to_learned: Option<u64>,
}

/// Why a history cannot be used.
#[derive(Debug, Error)]
pub enum HistoryError {
    /// The file can't be read.
    #[error("{}: {source}", path.display())]
    File {
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line is not a valid history line.
    #[error("{}:{line}: {source}", path.display())]
    Line {
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
/// [`HistoryError`] names the file and, if a line is invalid, its number.
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
    /// The forecasts of a tick, if the line has them.
    pub const fn output(&self) -> Option<&Output> {
        if let Self::Forecasts(output) = self { Some(output) } else { None }
    }
}

impl Output {
    /// The observation of a frame.
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
            new_session: header.has(flags::NEW_SESSION),
            impossible: forecasts.iter().find_map(impossible),
            incarnations: stages.collect(),
            forecasts: forecasts.iter().map(ForecastSeen::of).collect(),
        }
    }

    /// Number of forecasts of a quality.
    #[must_use]
    pub fn count(&self, quality: Quality) -> u64 {
        self.forecasts.iter().filter(|forecast| forecast.quality == quality.name()).count() as u64
    }

    /// Number of forecasts that are not learned, by cause.
    pub fn causes(&self) -> BTreeMap<&str, u64> {
        let mut causes = BTreeMap::new();
        for forecast in self.forecasts.iter().filter(|forecast| !forecast.is_learned()) {
            *causes.entry(forecast.cause.as_str()).or_default() += 1;
        }
        causes
    }

    /// Number of degraded forecasts ([`ForecastSeen::is_degraded`]).
    pub fn degraded(&self) -> u64 {
        self.forecasts.iter().filter(|forecast| forecast.is_degraded()).count() as u64
    }

    /// The greatest age of a held forecast.
    pub fn age_ms_max(&self) -> f64 {
        let held = self.forecasts.iter().filter(|forecast| forecast.quality == Quality::Held.name());
        held.map(|forecast| forecast.age_ns as f64 / 1e6).fold(0.0, f64::max)
    }

    /// Whether the forecasts are learned again: no forecast is degraded, and at least one is learned if there
    /// are any.
    pub fn is_learned(&self) -> bool {
        let some = self.count(Quality::Learned) > 0 || self.forecasts.is_empty();
        !self.void && !self.predicted && self.degraded() == 0 && some
    }
}

impl ForecastSeen {
    fn of(forecast: &Forecast) -> Self {
        let quality = Quality::from_number(forecast.quality);
        let has_controls = forecast.steering != Steering::None as u32;
        Self {
            id: forecast.id,
            quality: quality
                .map_or_else(|| format!("number {}", forecast.quality), |quality| quality.name().to_owned()),
            cause: Cause::name_of(forecast.cause).into_owned(),
            age_ns: forecast.age_ns,
            at_m: [forecast.x_m, forecast.y_m],
            print: if has_controls { print(forecast) } else { 0 },
        }
    }

    /// Whether the forecast claims to be the model's forecast of this tick.
    pub fn is_learned(&self) -> bool {
        self.quality == Quality::Learned.name()
    }

    /// Whether the model made a forecast in this tick, even if another expert proved better. A later held
    /// forecast repeats the newest of these.
    pub fn is_of_the_model(&self) -> bool {
        self.is_learned() || self.cause == Cause::Outdone.name()
    }

    /// Whether it is not learned for a cause other than a young track or a better expert.
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
