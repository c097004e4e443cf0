//! Topics that the pipeline file declares. Their types are known only at run time, by name and size.

use run::{Run, TopicRun, injected_topic};

use crate::limits::{Limits, NODES_MAX};

/// Limits of a declared topic without the stages that read it. Six other processes may read it: the recorder,
/// the launcher, the tap, an injector and two more.
pub(crate) const LIMITS: Limits =
    Limits { publishers_max: 1, subscribers_max: 6, nodes_max: NODES_MAX, depth_max: 8 };
/// The topic name in errors about declared topics: errors hold names that live as long as the program.
pub(crate) const TOPIC: &str = "added by the pipeline file";

/// What the pipeline file adds to the shipped stages and topics.
#[derive(Debug)]
pub(crate) struct Added {
    pub stage_count: usize,
    topics: Vec<TopicRun>,
    /// Names of the topics that the added stages read. A topic that n stages read is in the list n times.
    reads: Vec<String>,
    /// Number of stages that read each declared topic.
    readers: Vec<usize>,
}

impl Added {
    pub fn of(run: &Run) -> Self {
        Self {
            stage_count: run.added().count(),
            reads: run.added().flat_map(|(_, stage)| stage.reads.clone()).collect(),
            readers: run.topics.iter().map(|topic| run.readers(&topic.name).count()).collect(),
            topics: run.topics.clone(),
        }
    }

    /// The declared topic with this name in shared memory. The name may be the topic's own or an injector's.
    pub fn topic(&self, name: &str) -> Option<&TopicRun> {
        let find = |name| self.topics.iter().find(|topic| topic.name == name);
        find(name).or_else(|| find(injected_topic(name)?))
    }

    /// How many added stages read a topic.
    pub fn reader_count(&self, topic: &str) -> usize {
        self.reads.iter().filter(|read| *read == topic).count()
    }

    /// The limits of a declared topic.
    pub fn limits(&self, topic: &TopicRun) -> Limits {
        let readers = self.topics.iter().zip(&self.readers).find(|(other, _)| other.name == topic.name);
        Limits {
            subscribers_max: LIMITS.subscribers_max + readers.map_or(0, |(_, len)| *len),
            nodes_max: LIMITS.nodes_max + self.stage_count,
            ..LIMITS
        }
    }
}
