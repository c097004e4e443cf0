use serde::{Deserialize, Serialize};

/// Something that happened to the run, beside its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// When, `CLOCK_MONOTONIC`.
    pub at_ns: u64,
    /// What.
    #[serde(flatten)]
    pub what: Happened,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Happened {
    /// All stages are linked: the run has begun.
    Linked,
    /// A stage has died and is started again.
    Died {
        /// The stage.
        stage: String,
        /// How it ended, to follow its name.
        how: String,
        /// Its next incarnation.
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
    /// A stage was to be replaced by another program.
    Replaced {
        /// The stage.
        stage: String,
        /// What came of it: `replaced`, `not used` or `rolled back`.
        outcome: String,
        /// The new program.
        program: String,
        /// Why it is not used, to follow "it "; empty where it is.
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
        /// Its incarnation.
        incarnation: u32,
        /// Who sent the frames.
        sender: String,
        /// Why.
        cause: String,
        /// How many since the last such event.
        frames: u64,
    },
    /// Frames are not in the recording.
    Lost {
        /// Where: `tap` (it was not in time at the topic), `queue` (the tool was not in time at the tap), `disk`.
        at: String,
        /// The topic.
        topic: String,
        /// How many.
        frames: u64,
    },
    /// A flight recorder kept what was before this.
    Kept {
        /// Why.
        why: String,
    },
    /// Somebody marked this moment.
    Mark {
        /// With these words.
        text: String,
    },
    /// The launcher has ended the run.
    Ended {
        /// Why.
        how: String,
    },
}

/// A line that a stage wrote.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogLine {
    /// When the launcher had it, `CLOCK_MONOTONIC`.
    pub at_ns: u64,
    /// The stage.
    pub stage: String,
    /// The line.
    pub line: String,
}
