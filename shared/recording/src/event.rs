use std::fmt;

use serde::{Deserialize, Serialize};

/// An event of the run, besides its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Time of the event, on `CLOCK_MONOTONIC`.
    pub at_ns: u64,
    /// The kind of event.
    #[serde(flatten)]
    pub what: Happened,
}

/// The kinds of events.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Happened {
    /// All stages are linked: the run has started.
    Linked,
    /// A stage has died and is started again.
    Died {
        /// The stage.
        stage: String,
        /// How it ended, to follow its name.
        how: String,
        /// Next incarnation.
        next: u32,
    },
    /// A stage has ended and is not started again.
    GivenUp {
        /// The stage.
        stage: String,
        /// How it ended, to follow its name.
        how: String,
        /// Why it is given up.
        why: String,
    },
    /// A stage was replaced by another program, or the replacement failed.
    Replaced {
        /// The stage.
        stage: String,
        /// The outcome: `replaced`, `not used` or `rolled back`.
        outcome: String,
        /// The new program.
        program: String,
        /// Why the new program is not used, as a phrase that follows "it "; empty if it is used.
        cause: String,
    },
    /// A stage gets no CPU.
    Starved {
        /// The stage.
        stage: String,
    },
    /// A stage has refused frames.
    Refused {
        /// The stage.
        stage: String,
        /// Incarnation.
        incarnation: u32,
        /// The sender of the frames.
        sender: String,
        /// The reason.
        cause: String,
        /// Number of frames since the last such event.
        frames: u64,
    },
    /// Frames are missing in the recording.
    Lost {
        /// The place of the loss: `tap` (the tap was late at the topic), `queue` (the tool was late at the
        /// tap) or `disk`.
        at: String,
        /// The topic.
        topic: String,
        /// Number of frames.
        frames: u64,
    },
    /// A flight recorder kept the messages before this event.
    Kept {
        /// The reason.
        why: String,
    },
    /// A user marked this moment.
    Mark {
        /// The text of the mark.
        text: String,
    },
    /// The launcher has ended the run.
    Ended {
        /// The reason.
        how: String,
    },
}

impl fmt::Display for Happened {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Linked => write!(f, "all stages are linked"),
            Self::Died { stage, how, .. } => write!(f, "the {stage} {how}, and is started again"),
            Self::GivenUp { stage, how, why } => write!(f, "the {stage} {how} and is given up: {why}"),
            Self::Replaced { stage, outcome, program, cause } => match cause.as_str() {
                "" => write!(f, "the {stage} is {outcome} by {program}"),
                cause => write!(f, "the {stage} by {program}: {outcome}, it {cause}"),
            },
            Self::Starved { stage } => write!(f, "the {stage} gets no CPU"),
            Self::Refused { stage, sender, cause, frames, .. } => {
                write!(f, "the {stage} refused frames of the {sender} ({frames}): {cause}")
            }
            Self::Lost { at, topic, frames } => {
                write!(f, "{frames} frames of {topic} not recorded, at the {at}")
            }
            Self::Kept { why } => write!(f, "kept by the flight recorder: {why}"),
            Self::Mark { text } => write!(f, "mark: {text}"),
            Self::Ended { how } => write!(f, "the run has ended: {how}"),
        }
    }
}

/// A line that a stage wrote.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogLine {
    /// When the launcher received the line, on `CLOCK_MONOTONIC`.
    pub at_ns: u64,
    /// The stage.
    pub stage: String,
    /// The line.
    pub line: String,
}
