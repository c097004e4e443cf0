//! The run's record: written by the launcher, read by every stage.
//!
//! The encoding (bincode) is private to this module. The file starts with a line of text: [`MAGIC`], the schema,
//! the writer's version and the check value of the rest. A stage of another version refuses the file instead
//! of misreading it, and a file of another build is not taken for a damaged one.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use bincode::config::standard;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::{ForecastsTopic, HeartbeatsTopic, StageId, TICK_NS, Topic, WorldOrigin, crc64};

use crate::is_feedback;

/// First bytes of a record's file.
const MAGIC: &str = "stgdat-run ";
/// Version of the record. It increases with every change of [`Run`].
const SCHEMA: u32 = 11;
/// Version of this program.
const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Size of the largest accepted record. Real records have a few kilobytes.
const BYTES_MAX: u64 = 1 << 20;

/// Topics that are protected by default: the input from a sensor, and the output to a planner.
pub const PROTECTED: [&str; 2] = ["detections", "forecasts"];

/// The settings of one stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageRun {
    /// [`StageId`] as a number.
    pub stage: u32,
    /// The stage's share of the tick; `None` for a stage that no forecast waits for.
    pub budget_ms: Option<f64>,
    /// Whether it is this project's own program, which sends heartbeats.
    pub built_in: bool,
    /// The options as TOML. No other program reads them.
    pub options: String,
    /// The name; empty for one of stgdat's own stages.
    #[serde(default)]
    pub name: String,
    /// File name of an external program, such as `stgdat-bridge`; empty for one of stgdat's own.
    #[serde(default)]
    pub program: String,
    /// Where each option is set, for errors: file and line, or the argument.
    #[serde(default)]
    pub places: BTreeMap<String, String>,
    /// Topics that it reads, by their names in shared memory.
    #[serde(default)]
    pub reads: Vec<String>,
    /// Topics that it writes, by their names in shared memory.
    #[serde(default)]
    pub writes: Vec<String>,
}

/// A topic that the pipeline file declares.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicRun {
    /// Name in shared memory.
    pub name: String,
    /// Name of the type of its elements.
    pub type_name: String,
    /// Size of an element, in bytes.
    pub element_size: usize,
}

/// Suffix of the topic name that the writer opens if a program is placed between the writer and the readers.
const INJECTED_SUFFIX: &str = "-injected";

/// The name under which a topic's writer opens it if an injector is placed between the writer and the
/// readers.
#[must_use]
pub fn injected_name(topic: &str) -> String {
    format!("{topic}{INJECTED_SUFFIX}")
}

/// The topic that a writer opens under this name because of an injector.
#[must_use]
pub fn injected_topic(name: &str) -> Option<&str> {
    name.strip_suffix(INJECTED_SUFFIX)
}

/// The settings on which all stages of one run agree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Number in the header of every frame, which distinguishes the frames of two runs.
    pub id: u64,
    /// Prefix of the names of the run's shared memory.
    pub prefix: String,
    /// The run's own directory.
    pub root: PathBuf,
    /// Interval between frames.
    pub interval_ns: u64,
    /// Whether each tick waits for the end of the previous one, and no stage gives up waiting.
    pub lockstep: bool,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Topics whose frames carry a check value. Their readers require it.
    pub protected: Vec<String>,
    /// Whether a tick that is short of time leaves out some agents to serve the others.
    pub shed: bool,
    /// The file of the weights; `None` for the embedded weights.
    pub weights: Option<PathBuf>,
    /// The world frame's origin in the frame of maps, recordings and detections, m: see [`Run::origin`].
    #[serde(default)]
    pub origin_m: [f64; 2],
    /// The stages, in the order in which a tick passes them.
    pub stages: Vec<StageRun>,
    /// The topics that the pipeline file declares.
    #[serde(default)]
    pub topics: Vec<TopicRun>,
    /// The spares: processes in addition to the stages, with their own places on topics.
    pub spares: Vec<SpareRun>,
    /// Number of additional reader places of a topic, by its name.
    #[serde(default)]
    pub readers: BTreeMap<String, u32>,
}

/// A process that waits to take the place of a stage's process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SpareRun {
    /// [`StageId`] as a number.
    pub stage: u32,
    /// The topics that its stage reads and writes.
    pub topics: Vec<String>,
}

impl SpareRun {
    /// Whether it takes a place on a topic. All spares may open the heartbeats: they send, and some listen.
    #[must_use]
    pub fn opens(&self, topic: &str) -> bool {
        topic == HeartbeatsTopic::NAME || self.topics.iter().any(|name| name == topic)
    }
}

/// Why a run's record cannot be used.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The file can't be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The record's file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a record.
    #[error("{}: not the record of a run", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// The launcher and the stage are of different versions.
    #[error(
        "{}: written by stgdat {version}, schema {found}; this program has version {VERSION}, schema {SCHEMA}: \
         build launcher and stage from the same sources",
        path.display()
    )]
    Schema {
        /// The record's file.
        path: PathBuf,
        /// The record's schema.
        found: u32,
        /// The version of the program that wrote the record.
        version: String,
    },
    /// The record is whole, but the two programs do not agree on its fields.
    #[error(
        "{}: written by another build of stgdat {version} ({source}): build launcher and stage from the same \
         sources",
        path.display()
    )]
    OtherBuild {
        /// The record's file.
        path: PathBuf,
        /// The version of the program that wrote the record.
        version: String,
        /// The decoder's error.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The record cannot be encoded because a path is not UTF-8.
    #[error("{}: {source}", path.display())]
    Unwritable {
        /// The record's file.
        path: PathBuf,
        /// The encoder's error.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The record does not match its check value.
    #[error("{}: damaged record", path.display())]
    Damaged {
        /// The record's file.
        path: PathBuf,
    },
}

impl Default for Run {
    /// A run with the embedded weights in real time, without any stage.
    fn default() -> Self {
        Self {
            id: 0,
            prefix: String::new(),
            root: PathBuf::new(),
            interval_ns: TICK_NS,
            lockstep: false,
            seed: 1,
            protected: PROTECTED.map(str::to_owned).to_vec(),
            shed: true,
            weights: None,
            origin_m: [0.0; 2],
            stages: Vec::new(),
            spares: Vec::new(),
            topics: Vec::new(),
            readers: BTreeMap::new(),
        }
    }
}

impl Run {
    /// The world frame's origin in the frame of the run's map, recording or detections. It is subtracted in
    /// `f64` from all incoming positions, and added to the positions in files that the run writes.
    pub fn origin(&self) -> WorldOrigin {
        WorldOrigin::new(self.origin_m).unwrap_or_default()
    }

    /// The settings of a stage, if the pipeline has it.
    #[must_use]
    pub fn stage(&self, stage: StageId) -> Option<&StageRun> {
        self.stages.iter().find(|s| s.stage == stage.number())
    }

    /// The shares of the tick, for stages that have one.
    pub fn budgets_ms(&self) -> BTreeMap<StageId, f64> {
        let stages = self.stages.iter();
        stages.filter_map(|stage| Some((StageId::from_number(stage.stage)?, stage.budget_ms?))).collect()
    }

    /// The topics that each stage reads and writes.
    pub fn topics_of_stages(&self) -> BTreeMap<StageId, [Vec<String>; 2]> {
        let stages = self.stages.iter();
        let of = |stage: &StageRun| {
            Some((StageId::from_number(stage.stage)?, [stage.reads.clone(), stage.writes.clone()]))
        };
        stages.filter_map(of).collect()
    }

    /// The deadline of a stage, as time after the release of a tick. Agents that it has not served by then
    /// are left out.
    ///
    /// The deadline is the sum of the budgets up to the stage's own. It is scaled to the interval if that is
    /// shorter than a tick. Returns `None` in lockstep, if nothing is to be shed, and for a stage without a
    /// budget.
    #[must_use]
    pub fn deadline_ns(&self, stage: StageId) -> Option<u64> {
        let budgets_ms = self.budgets_ms();
        if self.lockstep || !self.shed || !budgets_ms.contains_key(&stage) {
            return None;
        }
        let up_to = StageId::ALL.into_iter().take_while(|other| *other != stage).chain([stage]);
        let added = self.before(stage).into_iter().filter(|other| other.is_added() && *other != stage);
        let sum_ms: f64 = up_to.chain(added).filter_map(|stage| budgets_ms.get(&stage)).sum();
        let scale = self.interval_ns.min(TICK_NS) as f64 / TICK_NS as f64;
        Some((sum_ms * 1e6 * scale) as u64)
    }

    /// The time of a tick that remains for the sampler after the decoder's [`Run::deadline_ns`]; 0 if the
    /// decoder has no deadline.
    pub fn left_for_sampler_ns(&self) -> u64 {
        let decoder_ns = self.deadline_ns(StageId::Decoder).unwrap_or(u64::MAX);
        self.interval_ns.min(TICK_NS).saturating_sub(decoder_ns)
    }

    /// Registers the names of the added stages in this process.
    pub fn name_stages(&self) {
        for stage in self.stages.iter().filter(|stage| !stage.name.is_empty()) {
            if let Some(id) = StageId::from_number(stage.stage).filter(|id| id.is_added()) {
                StageId::name_added((id.number() - StageId::ADDED_FIRST) as usize, &stage.name);
            }
        }
    }

    /// The topic of this name that the pipeline file declares.
    #[must_use]
    pub fn topic(&self, name: &str) -> Option<&TopicRun> {
        self.topics.iter().find(|topic| topic.name == name)
    }

    /// Whether the forecasts of a tick wait for this topic, by its name in shared memory.
    #[must_use]
    pub fn is_on_way(&self, topic: &str) -> bool {
        let way = self.before(StageId::Sampler);
        let mut readers = self.readers(topic).filter_map(|stage| StageId::from_number(stage.stage));
        topic == ForecastsTopic::NAME
            || readers.any(|stage| way.contains(&stage) && !is_feedback(stage, topic))
    }

    /// Stages that read a topic, by its name in shared memory.
    pub fn readers(&self, topic: &str) -> impl Iterator<Item = &StageRun> {
        self.stages.iter().filter(move |stage| stage.reads.iter().any(|read| read == topic))
    }

    /// The added stages, in the order of the pipeline file.
    pub fn added(&self) -> impl Iterator<Item = (StageId, &StageRun)> {
        let ids = self.stages.iter().map(|stage| StageId::from_number(stage.stage));
        ids.zip(&self.stages).filter_map(|(id, stage)| Some((id.filter(|id| id.is_added())?, stage)))
    }

    /// The stages whose output reaches `stage` within a tick, including `stage`.
    #[must_use]
    pub fn before(&self, stage: StageId) -> Vec<StageId> {
        let (mut found, mut open) = (Vec::new(), vec![stage]);
        while let Some(stage) = open.pop() {
            if found.contains(&stage) {
                continue;
            }
            found.push(stage);
            let Some(own) = self.stage(stage) else { continue };
            for topic in own.reads.iter().filter(|topic| !is_feedback(stage, topic)) {
                let writers = self.stages.iter().filter(|other| other.writes.contains(topic));
                open.extend(writers.filter_map(|writer| StageId::from_number(writer.stage)));
            }
        }
        found
    }

    /// stgdat's own stages and the added ones, in the order in which a tick passes them.
    pub fn order(&self) -> Vec<StageId> {
        let mut order: Vec<StageId> =
            StageId::ALL.into_iter().chain(self.added().map(|(id, _)| id)).collect();
        order.sort_by_cached_key(|stage| self.before(*stage).len());
        order
    }

    /// The added stages that no forecast waits for.
    pub fn side_stages(&self) -> Vec<StageId> {
        let way = self.before(StageId::Sampler);
        self.added().map(|(id, _)| id).filter(|id| !way.contains(id)).collect()
    }

    /// Writes the record.
    ///
    /// # Errors
    /// [`RecordError::File`] if the file can't be written, [`RecordError::Unwritable`] if a path is not
    /// UTF-8.
    pub fn write(&self, path: &Path) -> Result<(), RecordError> {
        let body = bincode::serde::encode_to_vec(self, standard())
            .map_err(|e| RecordError::Unwritable { path: path.to_owned(), source: e.into() })?;
        let first = format!("{MAGIC}{SCHEMA} {VERSION} {:016x}\n", crc64(&[&body]));
        let bytes = [first.as_bytes(), &body].concat();
        std::fs::write(path, bytes).map_err(|source| RecordError::File { path: path.to_owned(), source })
    }

    /// Reads a record that [`Run::write`] wrote.
    ///
    /// # Errors
    /// [`RecordError`] if the file cannot be read, is not a record, is damaged or is of another build.
    pub fn read(path: &Path) -> Result<Self, RecordError> {
        let file = |source| RecordError::File { path: path.to_owned(), source };
        let foreign = || RecordError::Foreign { path: path.to_owned() };
        if std::fs::metadata(path).map_err(file)?.len() > BYTES_MAX {
            return Err(foreign());
        }
        let bytes = std::fs::read(path).map_err(file)?;
        let line_end = bytes.iter().position(|&b| b == b'\n').ok_or_else(foreign)?;
        let (first, body) = (&bytes[..line_end], &bytes[line_end + 1..]);
        let first = std::str::from_utf8(first).ok().and_then(|line| line.strip_prefix(MAGIC));
        let mut words = first.ok_or_else(foreign)?.split(' ');
        let found: u32 = words.next().and_then(|number| number.parse().ok()).ok_or_else(foreign)?;
        let (path, version) = (path.to_owned(), words.next().unwrap_or("of an unknown version").to_owned());
        if found != SCHEMA {
            return Err(RecordError::Schema { path, found, version });
        }
        if words.next().and_then(|crc| u64::from_str_radix(crc, 16).ok()) != Some(crc64(&[body])) {
            return Err(RecordError::Damaged { path });
        }
        let run: Self = match bincode::serde::decode_from_slice(body, standard()) {
            Ok((run, used)) if used == body.len() => run,
            Ok(_) => {
                return Err(RecordError::OtherBuild { path, version, source: "it has more fields".into() });
            }
            Err(error) => return Err(RecordError::OtherBuild { path, version, source: error.into() }),
        };
        run.name_stages();
        Ok(run)
    }
}

#[cfg(test)]
mod tests;
