//! What happens to the stages, for the log and the run's tools.

use std::fmt;
use std::time::Duration;

use recorder::{ReplacementOutcome, program_name};
use recording::Happened;
use rustix::process::Pid;
use wire::StageId;

use crate::cleaner::Hung;
use crate::readers::DeadReader;

/// The progress or outcome of a replacement.
#[derive(Clone, Debug)]
pub struct Replaced {
    /// The stage.
    pub stage: StageId,
    /// The new program with its arguments; empty for the built-in one.
    pub command: Vec<String>,
    /// The outcome, as far as it is known.
    pub outcome: ReplacementOutcome,
    /// The incarnation that remains.
    pub incarnation: u32,
    /// Why the new process is not used, phrased to follow "it ".
    pub cause: String,
    /// Time until the new process was ready.
    pub warm_up: Option<Duration>,
    /// Time from the request to the old process to end until the new one takes over.
    pub hand_over: Option<Duration>,
}

impl fmt::Display for Replaced {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (stage, program) = (self.stage.name(), program_name(&self.command));
        match self.outcome {
            ReplacementOutcome::Replaced => {
                let ms = |time: Option<Duration>| time.unwrap_or_default().as_millis();
                let (warm, over) = (ms(self.warm_up), ms(self.hand_over));
                write!(
                    f,
                    "the {stage} is replaced by {program}: warm after {warm} ms, handed over in {over} ms"
                )
            }
            ReplacementOutcome::NotUsed => {
                write!(
                    f,
                    "the {stage} is not replaced by {program}: it {}; the old one continues",
                    self.cause
                )
            }
            ReplacementOutcome::RolledBack => {
                let cause = &self.cause;
                write!(
                    f,
                    "the {stage} is rolled back from {program}: it {cause}; the old program is started again"
                )
            }
        }
    }
}

/// An event of a stage.
#[derive(Debug)]
pub enum Event {
    /// The stage has died and will be restarted.
    Died {
        /// The stage.
        stage: StageId,
        /// How the stage ended, phrased to follow its name.
        how: String,
        /// The stage's next incarnation.
        next: u32,
    },
    /// The stage has ended and will not be restarted.
    GivenUp {
        /// The stage.
        stage: StageId,
        /// How the stage ended, phrased to follow its name.
        how: String,
        /// The reason for giving up.
        why: &'static str,
    },
    /// A detector has ended before the run has begun, and will be restarted.
    NotReady {
        /// The stage.
        stage: StageId,
        /// How the stage ended and its last line, phrased to follow its name.
        how: String,
    },
    /// The stage gets no CPU time.
    Starved {
        /// The stage.
        stage: StageId,
    },
    /// The old process has ended and the new one takes over.
    HandedOver(Replaced),
    /// A replacement has an outcome.
    Tried(Replaced),
    /// The spare has taken over after the stage's death.
    Promoted {
        /// The stage.
        stage: StageId,
    },
    /// A killed process does not end, because it is in a system call that does not end.
    CannotDie {
        /// The stage.
        stage: StageId,
        /// The process.
        pid: Pid,
    },
    /// A clean-up after dead processes timed out and will be retried.
    CleanUpHung(Hung),
    /// A process that read topics and is not a stage has died.
    ReaderDied(DeadReader),
    /// The spare has died too often and will not be restarted.
    SpareGivenUp {
        /// The stage.
        stage: StageId,
        /// How the spare ended, phrased to follow its name.
        how: String,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HandedOver(replaced) | Self::Tried(replaced) => write!(f, "{replaced}"),
            Self::Promoted { stage } => write!(f, "the spare of the {} takes its place", stage.name()),
            Self::CannotDie { stage, pid } => {
                let (stage, pid) = (stage.name(), pid.as_raw_nonzero());
                write!(f, "the {stage} (process {pid}) was killed but does not end: the kernel holds it")
            }
            Self::NotReady { stage, how } => {
                let stage = stage.name();
                write!(f, "WAITING for {stage}: the {stage} {how}")
            }
            Self::CleanUpHung(hung) => write!(f, "{hung}"),
            Self::ReaderDied(reader) => write!(f, "{reader}"),
            Self::SpareGivenUp { stage, how } => write!(f, "the {}: {how}", stage.name()),
            Self::Died { .. } | Self::GivenUp { .. } | Self::Starved { .. } => {
                self.happened().map_or(Ok(()), |what| write!(f, "{what}"))
            }
        }
    }
}

impl Event {
    /// Whether the log has it. A replacement is logged once it has an outcome.
    pub fn is_logged(&self) -> bool {
        match self {
            Self::HandedOver(_) => false,
            Self::ReaderDied(reader) => reader.is_logged(),
            _ => true,
        }
    }

    /// Returns the event for the run's tools; `None` for unfinished events.
    pub fn happened(&self) -> Option<Happened> {
        let name = |stage: &StageId| stage.name().to_owned();
        Some(match self {
            Self::Died { stage, how, next } => {
                Happened::Died { stage: name(stage), how: how.clone(), next: *next }
            }
            Self::GivenUp { stage, how, why } => {
                Happened::GivenUp { stage: name(stage), how: how.clone(), why: (*why).to_owned() }
            }
            Self::Starved { stage } => Happened::Starved { stage: name(stage) },
            Self::HandedOver(_)
            | Self::NotReady { .. }
            | Self::Promoted { .. }
            | Self::CannotDie { .. }
            | Self::CleanUpHung(_)
            | Self::ReaderDied(_)
            | Self::SpareGivenUp { .. } => return None,
            Self::Tried(Replaced { stage, command, outcome, cause, .. }) => Happened::Replaced {
                stage: name(stage),
                outcome: outcome.name().to_owned(),
                program: recorder::program_name(command),
                cause: cause.clone(),
            },
        })
    }
}
