use crate::{Event, Frame, LogLine};

/// A message of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A frame.
    Frame(Frame),
    /// A frame from before the file's start: its header, and only the bytes of its elements that a replay
    /// needs.
    Before(Frame),
    /// An event of the run.
    Event(Event),
    /// A line of a stage's log.
    Line(LogLine),
}

impl Message {
    /// Time of receipt or of the event, on `CLOCK_MONOTONIC`.
    pub const fn at_ns(&self) -> u64 {
        match self {
            Self::Frame(frame) | Self::Before(frame) => frame.received_ns(),
            Self::Event(event) => event.at_ns,
            Self::Line(line) => line.at_ns,
        }
    }
}
