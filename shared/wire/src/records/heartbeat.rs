use crate::declare::record;
use crate::{REFUSALS_MAX, Refusals};

record! {
    /// A stage's sign of life: element of the topic `heartbeats`.
    #[derive(Eq)]
    pub struct Heartbeat: 128 bytes {
        /// The stage's number.
        0 => stage: u32,
        /// Number of the stage's earlier starts.
        4 => incarnation: u32,
        /// The operating system's process number.
        8 => pid: u32,
        /// 1 after a frame has passed from the stage's input to its output, else 0.
        12 => linked: u32,
        /// Counts the stage's heartbeats.
        16 => beat: u64,
        /// Number of the newest tick that the stage has finished.
        24 => seq: u64,
        /// Number of finished frames.
        32 => frames_len: u64,
        /// Number of refused frames.
        40 => rejected_len: u64,
        /// Number of ticks with a frame that never arrived, by gaps in `seq`.
        48 => dropped_len: u32,
        /// The subset of these ticks whose missing frame starts a step: the stage has sent nothing for them.
        52 => unanswered_len: u32,
        /// Time of sending, on `CLOCK_MONOTONIC`.
        56 => sent_ns: u64,
        /// Number of refused frames by sender and cause, and the counts of the stage's link to other boxes.
        /// Frames without an entry only count in `rejected_len`.
        64 => refusals: [Refusals; REFUSALS_MAX],
    }
}
