use std::cell::RefCell;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::error::Error;
use std::io;
use std::path::PathBuf;

use run::{Exit, OptionError};
use thiserror::Error;
use wire::{Rejected, StageId};

use crate::monotonic_ns;

/// The error of another library or crate, with its type for [`Error::source`] and `downcast_ref`.
type Source = Box<dyn Error + Send + Sync>;

/// A port or the underlying transport is broken: the process can't continue.
#[derive(Debug, Error)]
pub enum PortError {
    /// This process can't join the run.
    #[error("{operation}: {source:?}")]
    Node {
        /// What was tried.
        operation: &'static str,
        /// The error of the transport or the system.
        source: Source,
    },
    /// Other users can change the run's shared memory.
    #[error("shared memory {0}…: other users can change it, or it belongs to another user")]
    NotPrivate(String),
    /// The transport refuses an operation on a topic.
    #[error("{operation} of topic \"{topic}\": {source:?}")]
    Topic {
        /// What was tried.
        operation: &'static str,
        /// The topic.
        topic: &'static str,
        /// The transport's error.
        source: Source,
    },
    /// All reader places of the topic are taken.
    #[error(
        "all {most} places for readers of topic \"{name}\" are taken: end one of them, or add places with \
         `readers = {{ {name} = 2 }}` above the first [[stage]] of pipeline.toml"
    )]
    NoPlace {
        /// The topic, by its name in shared memory.
        name: String,
        /// The number of reader places.
        most: usize,
    },
    /// A frame has more elements than the topic allows.
    #[error("loan of topic \"{topic}\": {found} elements, at most {most}")]
    TooMany {
        /// The topic.
        topic: &'static str,
        /// The requested number of elements.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// The process was a replacement, and was asked to end before its turn.
    #[error("asked to end before its turn")]
    NotNeeded,
    /// Waiting for frames fails in the operating system.
    #[error("waiting for frames: {0}")]
    Wait(#[source] io::Error),
    /// The socket that reports a topic's events is closed or broken.
    #[error("waiting for frames: a listener's socket is unusable, poll(2) reports events {events:#x}")]
    Socket {
        /// The `revents` of poll(2).
        events: u16,
    },
}

impl PortError {
    /// Turns an error of the transport into one that names the topic.
    pub(crate) fn of<E: Into<Source>>(
        operation: &'static str,
        topic: &'static str,
    ) -> impl FnOnce(E) -> Self {
        move |source| Self::Topic { operation, topic, source: source.into() }
    }

    /// Turns an error of the transport or the system into [`PortError::Node`].
    pub(crate) fn of_node<E: Into<Source>>(operation: &'static str) -> impl FnOnce(E) -> Self {
        move |source| Self::Node { operation, source: source.into() }
    }
}

/// Why a stage ends before it is asked to.
///
/// The variant gives the kind of failure and with it the exit code. The source keeps the error type of the
/// crate that failed.
#[derive(Debug, Error)]
pub enum StageError {
    /// A port or the transport under it is broken.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A recording, map, weights or memory file can't be used.
    #[error("{0}")]
    Data(#[source] Source),
    /// A file can't be opened or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The run's record, its model or a setting can't be used.
    #[error("{0}")]
    Config(#[source] Source),
    /// The stages did not pass on a frame of the source.
    #[error(
        "no answer to {awaited} of \"{topic}\" within {limit_ms} ms: {} did not pass it on",
        names(unlinked)
    )]
    NoAnswer {
        /// The frame that was not answered.
        awaited: Awaiting,
        /// The topic that carried the frame.
        topic: &'static str,
        /// How long the source waited.
        limit_ms: u64,
        /// The stages that are not linked; empty if all are.
        unlinked: Vec<StageId>,
    },
    /// The launcher died before the stage began.
    #[error("the launcher is gone")]
    LauncherGone,
}

/// The frame whose answer the source waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Awaiting {
    /// Frames that link the stages or end the run.
    StartOrEnd,
    /// The tick with this number.
    Tick(u64),
}

impl std::fmt::Display for Awaiting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::StartOrEnd => f.write_str("the start or end of the run"),
            Self::Tick(seq) => write!(f, "tick {seq}"),
        }
    }
}

fn names(stages: &[StageId]) -> String {
    let names: Vec<&str> = stages.iter().map(|stage| stage.name()).collect();
    if names.is_empty() { "a stage".to_owned() } else { names.join(", ") }
}

impl StageError {
    /// A recording, map, weights or memory file can't be used.
    pub fn data(error: impl Error + Send + Sync + 'static) -> Self {
        Self::Data(error.into())
    }

    /// The run's record, its model or a setting can't be used.
    pub fn config(error: impl Error + Send + Sync + 'static) -> Self {
        Self::Config(error.into())
    }

    /// The exit code for this kind of failure, which the launcher reads.
    #[must_use]
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Port(_) => Exit::Unavailable,
            Self::Data(_) | Self::File { .. } => Exit::Data,
            Self::Config(_) => Exit::Config,
            Self::NoAnswer { .. } | Self::LauncherGone => Exit::Failed,
        }
    }
}

impl From<OptionError> for StageError {
    fn from(error: OptionError) -> Self {
        Self::config(error)
    }
}

/// Time between two log lines on frames of one topic that are refused for one cause.
const REFUSED_PAUSE_NS: u64 = 1_000_000_000;

/// When a cause was logged last, and the number of frames that were only counted since.
#[derive(Clone, Copy, Debug)]
struct Logged {
    at_ns: u64,
    unlogged: u64,
}

thread_local! {
    /// By topic and cause.
    static LOGGED: RefCell<BTreeMap<(&'static str, u32), Logged>> = const { RefCell::new(BTreeMap::new()) };
}

/// Logs a refused frame, at most one a second for each topic and cause. The line has the number of frames that
/// were refused since the previous line.
pub(crate) fn log_refused(topic: &'static str, seq: u64, why: &Rejected) {
    match log_now(topic, why, monotonic_ns()) {
        Some(0) => tracing::warn!(topic, seq, "frame refused: {why}"),
        Some(unlogged) => tracing::warn!(topic, seq, unlogged, "frame refused: {why}"),
        None => {}
    }
}

/// The number of frames that were refused for the same cause since the last log line; `None` if this frame is
/// not logged either.
fn log_now(topic: &'static str, why: &Rejected, now_ns: u64) -> Option<u64> {
    LOGGED.with_borrow_mut(|logged| match logged.entry((topic, why.cause() as u32)) {
        Entry::Vacant(entry) => {
            entry.insert(Logged { at_ns: now_ns, unlogged: 0 });
            Some(0)
        }
        Entry::Occupied(mut entry) => {
            let Logged { at_ns, unlogged } = entry.get_mut();
            if now_ns.saturating_sub(*at_ns) < REFUSED_PAUSE_NS {
                *unlogged += 1;
                return None;
            }
            *at_ns = now_ns;
            Some(std::mem::take(unlogged))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use run::RecordError;

    #[test]
    fn a_stage_error_keeps_the_type_of_its_source() {
        let error = StageError::config(RecordError::Foreign { path: "a".into() });
        assert_eq!((error.to_string().as_str(), error.exit()), ("a: not the record of a run", Exit::Config));
        let source = error.source().and_then(|source| source.downcast_ref::<RecordError>());
        assert!(matches!(source, Some(RecordError::Foreign { .. })), "{source:?}");
        let broken = PortError::of("frames", "tracks")(io::Error::from_raw_os_error(28));
        let source = StageError::from(broken)
            .source()
            .and_then(|source| source.downcast_ref::<io::Error>())
            .and_then(io::Error::raw_os_error);
        assert_eq!(source, Some(28));
    }

    #[test]
    fn a_cause_is_logged_once_a_second_with_the_frames_since() {
        let late = Rejected::NotNewer { stamp_ns: 1, last_ns: 2 };
        let size = Rejected::Length { found: 1, expected: 2 };
        assert_eq!(log_now("tracks", &late, 5), Some(0));
        assert_eq!(log_now("tracks", &late, 6), None);
        assert_eq!(log_now("tracks", &late, 4 + REFUSED_PAUSE_NS), None);
        assert_eq!(log_now("tracks", &size, 7), Some(0), "another cause");
        assert_eq!(log_now("controls", &late, 7), Some(0), "another topic");
        assert_eq!(log_now("tracks", &late, 5 + REFUSED_PAUSE_NS), Some(2));
        assert_eq!(log_now("tracks", &late, 5 + 2 * REFUSED_PAUSE_NS), Some(0));
    }

    #[test]
    fn an_unanswered_frame_names_the_stages_that_are_not_linked() {
        let error = |unlinked| StageError::NoAnswer {
            awaited: Awaiting::Tick(7),
            topic: "detections",
            limit_ms: 60_000,
            unlinked,
        };
        let named = error(vec![StageId::Encoder, StageId::Sampler]);
        let expected =
            "no answer to tick 7 of \"detections\" within 60000 ms: encoder, sampler did not pass it on";
        assert_eq!((named.to_string().as_str(), named.exit()), (expected, Exit::Failed));
        assert!(error(Vec::new()).to_string().ends_with(": a stage did not pass it on"));
    }
}
