//! The graph of stages in pipeline.toml.

mod added;
mod check;
mod file;
mod options;
mod parse;
mod realtime;

use std::collections::BTreeMap;
use std::path::PathBuf;

pub use check::BUDGET_MAX_MS;
use run::TopicRun;
use supervisor::{RestartPolicy, Scheduling};
use wire::{StageId, WorldOrigin};

use crate::realtime::Realtime;

/// A process of the pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Id of the stage.
    pub id: StageId,
    /// Name of the stage.
    pub name: String,
    /// The program that runs as this stage, with its arguments; `None` for this project's own program.
    pub command: Option<Vec<String>>,
    /// Names of the topics that the stage reads.
    pub reads: Vec<String>,
    /// Names of the topics that the stage writes.
    pub writes: Vec<String>,
    /// Share of the 80 ms of a tick; `None` for a stage outside the tick's path.
    pub budget_ms: Option<f64>,
    /// Options of the stage. Its declaration checks them; they are unchecked if the stage has a `command`.
    pub options: toml::Table,
    /// File and line of each option, as `pipeline.toml:12`.
    pub places: BTreeMap<String, String>,
    /// Topics that the stage opens under another name, with this name.
    pub topics: BTreeMap<String, String>,
    /// The action when the stage ends.
    pub restart: RestartPolicy,
    /// Processors and priority.
    pub scheduling: Scheduling,
    /// Whether a second process waits to replace the stage.
    pub spare: bool,
}

/// A checked graph of stages, in the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Pipeline {
    /// The file of the weights; `None` for the embedded weights.
    pub weights: Option<PathBuf>,
    /// The world frame's origin in the frame of detections and map.
    pub origin: Option<WorldOrigin>,
    /// Topics whose frames carry a check value.
    pub protected: Vec<String>,
    /// Whether a tick that is short of time leaves out some agents to serve the others.
    pub shed: bool,
    /// The real-time settings of the run as a whole.
    pub realtime: Realtime,
    /// Number of additional reader places of topics, by topic.
    pub readers: BTreeMap<String, u32>,
    /// The stages.
    pub stages: Vec<Stage>,
    /// The topics that the file declares.
    pub topics: Vec<TopicRun>,
    /// Sum of the budgets on a tick's way.
    pub budget_ms: f64,
    /// Warnings for the file's author, such as about keys with a new name.
    pub warnings: Vec<String>,
}

impl Pipeline {
    /// The topics that a stage reads, by their names in shared memory.
    pub fn read_by<'a>(&'a self, stage: &'a Stage) -> impl Iterator<Item = &'a str> {
        stage.reads.iter().map(|topic| self.name_of(stage, topic))
    }

    /// The topics that a stage writes, by their names in shared memory.
    pub fn written_by<'a>(&'a self, stage: &'a Stage) -> impl Iterator<Item = &'a str> {
        stage.writes.iter().map(|topic| self.name_of(stage, topic))
    }

    /// The name in shared memory of a stage's topic, without an injector.
    fn name_of<'a>(&'a self, stage: &'a Stage, topic: &'a str) -> &'a str {
        let renamed = stage.topics.get(topic);
        renamed.and_then(|name| added::declared_name(name, &self.topics)).unwrap_or(topic)
    }

    /// The stage that writes a topic, by the topic's name in shared memory, and the name under which its
    /// program knows the topic.
    #[must_use]
    pub fn writer<'a>(&'a self, topic: &str) -> Option<(&'a Stage, &'a str)> {
        let mut writes =
            self.stages.iter().flat_map(|stage| stage.writes.iter().map(move |own| (stage, own.as_str())));
        writes.find(|(stage, own)| self.name_of(stage, own) == topic)
    }

    /// Gives `cpus` to the stages whose processors the file leaves to the machine.
    pub fn choose_cpus(&mut self, cpus: &[u32]) {
        let left_open = &self.realtime.auto_cpu;
        for stage in self.stages.iter_mut().filter(|stage| left_open.contains(&stage.id)) {
            stage.scheduling.cpus = cpus.to_vec();
        }
    }

    /// Registers the names of the added stages in this process.
    pub fn name_stages(&self) {
        for stage in self.stages.iter().filter(|stage| stage.id.is_added()) {
            StageId::name_added((stage.id.number() - StageId::ADDED_FIRST) as usize, &stage.name);
        }
    }

    /// The edges of the graph as (producer, topic, consumer), in the order of the file.
    #[must_use]
    pub fn edges(&self) -> Vec<(StageId, &str, StageId)> {
        let mut edges = Vec::new();
        for producer in &self.stages {
            for topic in self.written_by(producer) {
                let reads = |stage: &&Stage| self.read_by(stage).any(|read| read == topic);
                edges.extend(
                    self.stages.iter().filter(reads).map(|consumer| (producer.id, topic, consumer.id)),
                );
            }
        }
        edges
    }
}

#[cfg(test)]
mod tests;
