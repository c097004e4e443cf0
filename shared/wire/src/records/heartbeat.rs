use crate::declare::record;
use crate::{REFUSALS_MAX, Refusals};

record! {
    /// A stage's sign of life: element of the topic `heartbeats`.
    #[derive(Eq)]
    pub struct Heartbeat: 128 bytes {
        /// The stage's number.
        0 => stage: u32,
        /// How often the stage had been started before.
        4 => incarnation: u32,
        /// Operating system's number of the process.
        8 => pid: u32,
        /// 1 once a frame has passed from the stage's input to its output, else 0.
        12 => linked: u32,
        /// Counts the stage's heartbeats.
        16 => beat: u64,
        /// Number of the newest tick that the stage finished.
        24 => seq: u64,
        /// Frames finished.
        32 => frames_len: u64,
        /// Frames refused.
        40 => rejected_len: u64,
        /// Ticks of which a frame never arrived, by gaps in `seq`.
        48 => dropped_len: u32,
        /// Of these, ticks of which the frame that begins a step never arrived: the stage has sent nothing
        /// for them.
        52 => unanswered_len: u32,
        /// `CLOCK_MONOTONIC` at sending.
        56 => sent_ns: u64,
        /// Frames refused, by their sender and the cause. What finds no place is part of `rejected_len` alone.
        64 => refusals: [Refusals; REFUSALS_MAX],
    }
}
