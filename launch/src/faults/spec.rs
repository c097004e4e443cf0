//! The specification of a fault run, in TOML.

mod check;
mod error;
mod table;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ports::Point;
use run::TopicRun;
use serde::{Deserialize, Serialize};
use wire::StageId;

use crate::failure::Failure;
use crate::faults::effect::Effect;
pub use error::SpecError;
pub use table::{Counted, Expect};

/// What to run, what to inject, and what to expect.
#[derive(Clone, Debug)]
pub struct Spec {
    /// The file's name without its folder and ending.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// What it shows, in a sentence.
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
    /// Agents of the generated scene; the default of `run` where none.
    pub agents: Option<u64>,
    /// The recording; a generated scene where none.
    pub recording: Option<PathBuf>,
    /// Seed of the scene and of all faults that have none of their own.
    pub seed: u64,
    /// The pipeline.toml; the built-in one where none.
    pub pipeline: Option<PathBuf>,
    /// Names of the stages that it adds, in its order.
    pub added: Vec<String>,
    /// The topics that it declares.
    pub topics: Vec<TopicRun>,
    /// Where the recorder writes the forecasts; into the run's folder where none.
    pub forecasts: Option<PathBuf>,
    /// Topics whose frames carry a check value; those of the pipeline.toml where none.
    pub protect: Option<Vec<String>>,
    /// Keys of stages in place of those of the pipeline.toml, by the stage's name.
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

    /// The stage of that name.
    pub fn stage(&self, name: &str) -> Option<StageId> {
        self.stages().find(|(_, known)| *known == name).map(|(stage, _)| stage)
    }
}

/// One fault.
#[derive(Clone, Debug)]
pub enum Fault {
    /// A process is sent SIGKILL.
    Kill {
        /// Which.
        target: Target,
        /// When.
        when: When,
    },
    /// Stages are killed, or stopped for a time, at random ticks.
    Random {
        /// Which of them.
        stages: Vec<StageId>,
        /// The range of ticks, the last one included.
        ticks: [u64; 2],
        /// How often.
        count: u64,
        /// The time between SIGSTOP and SIGCONT; SIGKILL where none.
        stop_ms: Option<u64>,
    },
    /// A stage kills itself at a point of its step.
    KillAt {
        /// The stage.
        stage: StageId,
        /// The point.
        point: Point,
        /// From which tick on: the n-th is for its n-th process.
        ticks: Vec<u64>,
    },
    /// A process is sent SIGSTOP, and SIGCONT after a time.
    Stop {
        /// Which.
        target: Target,
        /// At which ticks.
        ticks: Vec<u64>,
        /// The time between the two.
        for_ms: u64,
    },
    /// A resource of a stage's process is limited.
    Limit {
        /// The stage.
        stage: StageId,
        /// At which tick.
        tick: u64,
        /// The resource.
        resource: Resource,
        /// The limit.
        value: u64,
    },
    /// A stage is killed, and every further process of it ends at once.
    CrashLoop {
        /// The stage.
        stage: StageId,
        /// At which tick it is killed.
        tick: u64,
        /// The exit code of its further processes.
        exit_code: u8,
    },
    /// Another program is put in a stage's place.
    Command {
        /// The stage.
        stage: StageId,
        /// The program with its arguments.
        command: Vec<String>,
    },
    /// A stage is replaced while the run goes on.
    Replace {
        /// The stage.
        stage: StageId,
        /// At which ticks.
        ticks: Vec<u64>,
        /// The new program with its arguments; the built-in one where none.
        command: Option<Vec<String>>,
        /// The point of its first step at which the new process kills itself.
        point: Option<Point>,
    },
    /// Frames of a topic are changed between its writer and its readers.
    Topic(TopicFault),
    /// Threads that do nothing but use the CPU.
    Cpu {
        /// At which tick.
        tick: u64,
        /// For how long.
        for_ms: u64,
        /// How many.
        threads: usize,
    },
    /// One more consumer, which gives the frames that it holds back late or never.
    Consumer {
        /// The topic.
        topic: String,
        /// Time for which it holds each frame; for ever where none.
        hold_ms: Option<u64>,
        /// Shortest and longest time after which it is killed and started again; it stays where none.
        within_ms: Option<[u64; 2]>,
    },
}

/// A process that a signal is sent to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A stage, of our own or of a command.
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
    /// So long after its first process has begun, once.
    AfterStart {
        /// Milliseconds.
        ms: u64,
    },
    /// The same, after a random time by the run's seed.
    Within {
        /// The shortest and the longest time in milliseconds.
        ms: [u64; 2],
    },
}

/// A resource of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resource {
    /// Open descriptors.
    Descriptors,
    /// Size of files that it writes: a full disk. Counts for its shared memory too.
    FileSize,
    /// Address space.
    Memory,
}

/// A fault between a topic's writer and its readers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TopicFault {
    /// The topic.
    pub topic: String,
    /// What is done to a frame.
    pub effect: Effect,
    /// The ticks on which it may act, the last one included.
    pub ticks: [u64; 2],
    /// The probability with which it acts on each of them.
    pub probability: f64,
    /// Seed of that choice and of what is done.
    pub seed: u64,
}

impl Spec {
    /// Reads and checks a specification.
    ///
    /// # Errors
    /// [`Failure::Spec`] points to the first place in the text that is wrong.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text =
            std::fs::read_to_string(path).map_err(|error| Failure::config_about(path.display(), error))?;
        Ok(Self::parse(path, &text)?)
    }

    /// Checks the text of a specification.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SpecError> {
        check::parse(path, text)
    }

    /// The faults between topics.
    pub fn topic_faults(&self) -> impl Iterator<Item = &TopicFault> {
        self.faults
            .iter()
            .filter_map(|fault| if let Fault::Topic(fault) = fault { Some(fault) } else { None })
    }

    /// The topics with an injector, each once.
    pub fn injected_topics(&self) -> Vec<&str> {
        let mut topics: Vec<&str> = self.topic_faults().map(|fault| fault.topic.as_str()).collect();
        topics.sort_unstable();
        topics.dedup();
        topics
    }

    /// The stages that a fault is aimed at: their restarts are expected.
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

    /// Greatest age of a held forecast by the sampler's policy; none where the pipeline is not the built-in one.
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
