//! The specification of a fault run, in TOML.

mod check;
mod table;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use ports::Point;
use run::TopicRun;
use wire::StageId;

use crate::effect::{Random, TopicFault};
pub use table::{Counted, Expect, Resource};

/// The run, its faults and the expectation.
#[derive(Clone, Debug)]
pub struct Spec {
    /// The file's stem.
    pub name: String,
    pub path: PathBuf,
    text: String,
    /// The property that it demonstrates, in one sentence.
    pub shows: String,
    pub run: RunSpec,
    pub faults: Faults,
    /// What is expected.
    pub expect: Expect,
}

/// The run that the faults are injected into.
#[derive(Clone, Debug)]
pub struct RunSpec {
    /// Its length.
    pub ticks: u64,
    /// Agents of the generated scene; `None` for the default of `run`.
    pub agents: Option<u64>,
    /// The recording; `None` for a generated scene.
    pub recording: Option<PathBuf>,
    /// Seed of the scene and of all faults without their own seed.
    pub seed: u64,
    /// The pipeline.toml; `None` for the built-in one.
    pub pipeline: Option<PathBuf>,
    /// Names of the added stages, in pipeline order.
    pub added: Vec<String>,
    /// The declared topics.
    pub topics: Vec<TopicRun>,
    /// The recorder's forecast file; `None` for the run's folder.
    pub forecasts: Option<PathBuf>,
    /// Topics whose frames carry a check value; `None` for the topics that pipeline.toml protects.
    pub protect: Option<Vec<String>>,
    /// Keys that override the stages' keys in pipeline.toml, by the stage's name.
    pub stages: BTreeMap<String, toml::Table>,
    /// Further arguments of `stgdat run`.
    pub arguments: Vec<String>,
}

impl RunSpec {
    /// All stages of the run, with their names.
    pub fn stages(&self) -> impl Iterator<Item = (StageId, &str)> {
        let added = self.added.iter().enumerate();
        let added = added.filter_map(|(place, name)| Some((StageId::added(place)?, name.as_str())));
        StageId::ALL.into_iter().map(|stage| (stage, stage.name())).chain(added)
    }

    /// Returns the stage with this name.
    pub fn stage(&self, name: &str) -> Option<StageId> {
        self.stages().find(|(_, known)| *known == name).map(|(stage, _)| stage)
    }
}

/// What the faults do.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// Number of faults.
    pub count: usize,
    /// The actions during the run.
    pub actions: Vec<Action>,
    /// The points at which stages kill themselves. The n-th tick is the first one of the n-th process.
    pub points: Vec<(StageId, Point, Vec<u64>)>,
    /// The programs that stages have instead of their own.
    pub commands: Vec<(StageId, Vec<String>)>,
    /// Frames that are changed between the writer and the readers of a topic.
    pub topics: Vec<TopicFault>,
    /// Additional consumers.
    pub consumers: Vec<Consumer>,
    /// The stages that faults target. Their restarts are expected.
    pub targets: Vec<StageId>,
    /// The stages that are killed or stopped at given times.
    signalled: Vec<StageId>,
}

/// An action at a given time.
#[derive(Clone, Debug)]
pub struct Action {
    pub at: Due,
    pub what: What,
}

/// The time of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// A tick.
    Tick(u64),
    /// A time after the start of a process.
    AfterStart(Target, Duration),
}

/// What is done to a process.
#[derive(Clone, Debug)]
pub enum What {
    /// SIGKILL.
    Kill(Target),
    /// SIGSTOP, and SIGCONT after a time.
    Stop(Target, Duration),
    /// A limit of a resource.
    Limit(StageId, Resource, u64),
    /// Threads that only use the CPU, for a time.
    Cpu(usize, Duration),
    /// A replacement by this program; empty for the built-in one.
    Replace(StageId, Vec<String>),
}

/// A consumer that returns its frames late or never.
#[derive(Clone, Debug)]
pub struct Consumer {
    pub topic: String,
    /// Time for which each frame is held; `None` for forever.
    pub hold_ms: Option<u64>,
    /// Shortest and longest time until it is killed and restarted; `None` if it is not killed.
    pub within_ms: Option<[u64; 2]>,
    /// The source of these times.
    pub random: Random,
}

/// The target process of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A stage, built in or external.
    Stage(StageId),
    Launcher,
}

impl Target {
    /// Its name.
    pub fn name(self) -> &'static str {
        self.stage().map_or("launcher", StageId::name)
    }

    /// The stage, if it is one.
    pub const fn stage(self) -> Option<StageId> {
        match self {
            Self::Stage(stage) => Some(stage),
            Self::Launcher => None,
        }
    }
}

impl Spec {
    /// Returns the topics with an injector, without duplicates.
    pub fn injected_topics(&self) -> Vec<&str> {
        let mut topics: Vec<&str> = self.faults.topics.iter().map(|fault| fault.topic.as_str()).collect();
        topics.sort_unstable();
        topics.dedup();
        topics
    }

    /// Maximum age of a held forecast under the sampler's policy; `None` if the pipeline is not the built-in
    /// one.
    pub fn held_max_ns(&self) -> Option<u64> {
        let of_run = || {
            let options = self.run.stages.get(StageId::Sampler.name())?.get("options")?;
            let held_s = options.get("held_s")?;
            held_s.as_float().or_else(|| held_s.as_integer().map(|held_s| held_s as f64))
        };
        let is_set =
            self.run.pipeline.is_some() || self.run.arguments.iter().any(|text| text.contains("held_s"));
        let by_default = (!is_set).then(|| sampler::Options::default().held_s);
        of_run().or(by_default).map(|held_s| (held_s * 1e9) as u64)
    }

    /// Whether the launcher itself is killed.
    pub fn kills_launcher(&self) -> bool {
        self.faults.actions.iter().any(|action| matches!(action.what, What::Kill(Target::Launcher)))
    }
}
