//! The specification of a fault run, in TOML.

mod check;
mod table;

use std::collections::BTreeMap;
use std::path::PathBuf;

use ports::Point;
use run::TopicRun;
use wire::StageId;

use crate::faults::effect::TopicFault;
pub use table::{Counted, Expect, Resource};

/// The run, its faults and the expectation.
#[derive(Clone, Debug)]
pub struct Spec {
    /// The file's stem.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// The property that it demonstrates, in one sentence.
    pub shows: String,
    /// The run.
    pub run: RunSpec,
    /// The faults.
    pub faults: Vec<Fault>,
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

/// One fault.
#[derive(Clone, Debug)]
pub enum Fault {
    /// A process is sent SIGKILL.
    Kill {
        /// The process.
        target: Target,
        /// The times.
        when: When,
    },
    /// Stages are killed, or stopped for a time, at random ticks.
    Random {
        /// The candidate stages.
        stages: Vec<StageId>,
        /// The range of ticks, inclusive.
        ticks: [u64; 2],
        /// Number of faults.
        count: u64,
        /// The time between SIGSTOP and SIGCONT; `None` for SIGKILL.
        stop_ms: Option<u64>,
    },
    /// A stage kills itself at a point of its step.
    KillAt {
        /// The stage.
        stage: StageId,
        /// The point.
        point: Point,
        /// First ticks: the n-th entry applies to the n-th process.
        ticks: Vec<u64>,
    },
    /// A process is sent SIGSTOP, and SIGCONT after a time.
    Stop {
        /// The process.
        target: Target,
        /// The ticks.
        ticks: Vec<u64>,
        /// The time between the two.
        for_ms: u64,
    },
    /// A resource of a stage's process is limited.
    Limit {
        /// The stage.
        stage: StageId,
        /// The tick.
        tick: u64,
        /// The resource.
        resource: Resource,
        /// The limit.
        value: u64,
    },
    /// A stage is killed, and each later process of it ends immediately.
    CrashLoop {
        /// The stage.
        stage: StageId,
        /// The tick at which it is killed.
        tick: u64,
        /// The exit code of its later processes.
        exit_code: u8,
    },
    /// Another program replaces a stage's program.
    Command {
        /// The stage.
        stage: StageId,
        /// The program with its arguments.
        command: Vec<String>,
    },
    /// A stage is replaced during the run.
    Replace {
        /// The stage.
        stage: StageId,
        /// The ticks.
        ticks: Vec<u64>,
        /// The new program with its arguments; `None` for the built-in one.
        command: Option<Vec<String>>,
        /// The point of its first step at which the new process kills itself.
        point: Option<Point>,
    },
    /// Frames of a topic are changed between its writer and its readers.
    Topic(TopicFault),
    /// Threads that only use the CPU.
    Cpu {
        /// The tick.
        tick: u64,
        /// The duration.
        for_ms: u64,
        /// The number of threads.
        threads: usize,
    },
    /// An additional consumer that returns its frames late or never.
    Consumer {
        /// The topic.
        topic: String,
        /// Time for which each frame is held; `None` for forever.
        hold_ms: Option<u64>,
        /// Shortest and longest time until it is killed and restarted; `None` if it is not killed.
        within_ms: Option<[u64; 2]>,
    },
}

/// The target process of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A stage, built in or external.
    Stage(StageId),
    /// The launcher.
    Launcher,
}

impl Target {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Stage(stage) => stage.name(),
            Self::Launcher => "launcher",
        }
    }
}

/// When a process is killed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum When {
    /// At these ticks.
    Ticks(Vec<u64>),
    /// Once, this long after the first process was started.
    AfterStart {
        /// Milliseconds.
        ms: u64,
    },
    /// The same, after a random time drawn from the run's seed.
    Within {
        /// The shortest and longest time in milliseconds.
        ms: [u64; 2],
    },
}

impl Spec {
    /// Returns the faults that act on topics.
    pub fn topic_faults(&self) -> impl Iterator<Item = &TopicFault> {
        self.faults
            .iter()
            .filter_map(|fault| if let Fault::Topic(fault) = fault { Some(fault) } else { None })
    }

    /// Returns the topics with an injector, without duplicates.
    pub fn injected_topics(&self) -> Vec<&str> {
        let mut topics: Vec<&str> = self.topic_faults().map(|fault| fault.topic.as_str()).collect();
        topics.sort_unstable();
        topics.dedup();
        topics
    }

    /// Returns the stages that faults target; their restarts are expected.
    pub fn targets(&self) -> Vec<StageId> {
        let random = self
            .faults
            .iter()
            .filter_map(|fault| if let Fault::Random { stages, .. } = fault { Some(stages) } else { None });
        let of = |fault: &Fault| match fault {
            Fault::Kill { target: Target::Stage(stage), .. }
            | Fault::Stop { target: Target::Stage(stage), .. } => Some(*stage),
            Fault::KillAt { stage, .. }
            | Fault::Limit { stage, .. }
            | Fault::CrashLoop { stage, .. }
            | Fault::Replace { stage, .. }
            | Fault::Command { stage, .. } => Some(*stage),
            _ => None,
        };
        random.flatten().copied().chain(self.faults.iter().filter_map(of)).collect()
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
        self.faults.iter().any(|fault| matches!(fault, Fault::Kill { target: Target::Launcher, .. }))
    }
}
