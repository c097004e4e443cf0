use std::sync::Arc;

use serde::{Deserialize, Serialize};
use wire::TABLE;

use crate::{Event, Frame, FrameError, LogLine, topic_number};

/// Name of the tap's socket in the run's folder.
pub const SOCKET: &str = "tap";
/// Longest request: a line.
pub const REQUEST_BYTES_MAX: usize = 4_096;
/// Maximum size of an item; a frame of the largest topic is smaller.
const ITEM_BYTES_MAX: usize = 1 << 28;

/// The request of a tool, sent as one line of JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// The tool's name, for messages.
    pub tool: String,
    /// The requested topics.
    pub topics: Vec<String>,
    /// Whether it requests events and log lines.
    pub events: bool,
    /// Text of a mark of this moment, for all tools.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mark: Option<String>,
    /// Name of the recording that the tool writes the events to, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
}

/// The recipients of a mark.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Marked {
    /// The newest tick, if a tool reads ticks.
    pub tick: Option<u64>,
    /// The recordings that have the mark.
    pub recordings: Vec<String>,
}

/// A request with topic numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Want {
    topics: u32,
    /// Whether events and log lines are wanted.
    pub events: bool,
}

impl Want {
    /// From a request. Topics that this version does not have are left out.
    #[must_use]
    pub fn of(request: &Request) -> Self {
        let numbers = request.topics.iter().filter_map(|name| topic_number(name));
        Self { topics: numbers.fold(0, |bits, number| bits | 1 << number), events: request.events }
    }

    /// Whether a topic is wanted.
    #[must_use]
    pub const fn has(&self, topic: u8) -> bool {
        self.topics & (1 << topic) != 0
    }
}

/// The items that a tool receives.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// The tool is attached and its topics are open: it receives everything from now on.
    Attached,
    /// A frame.
    Frame(Frame),
    /// An event of the run.
    Event(Event),
    /// A line of a stage's log.
    Line(LogLine),
    /// Frames that the tool did not receive.
    Lost(Lost),
    /// The tool's mark was forwarded.
    Marked(Marked),
    /// The tool is not attached, with the reason.
    Refused(String),
}

/// Frames that a tool did not receive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lost {
    /// The place of the loss.
    pub at: LostAt,
    /// The topic's number.
    pub topic: u8,
    /// Number of frames.
    pub frames: u64,
}

wire::named! {
    /// Places where frames are lost.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum LostAt {
        /// The tap was late at the topic.
        Tap => "tap",
        /// The tool was late at the tap.
        Queue => "queue",
    }
}

impl Lost {
    /// The topic.
    pub fn topic(&self) -> &'static str {
        TABLE.topics.get(usize::from(self.topic)).map_or("unknown", |topic| topic.name)
    }
}

/// Kinds of items on the wire.
mod kind {
    pub const FRAME: u8 = 1;
    pub const EVENT: u8 = 2;
    pub const LINE: u8 = 3;
    pub const LOST: u8 = 4;
    pub const ATTACHED: u8 = 5;
    pub const MARKED: u8 = 6;
    pub const REFUSED: u8 = 7;
}

/// Bytes before an item's body: the body's length, the kind, the topic, two zero bytes, the time of receipt.
const PREFIX: usize = 16;

fn packet(kind: u8, topic: u8, received_ns: u64, parts: [&[u8]; 2]) -> Arc<[u8]> {
    let len = (parts[0].len() + parts[1].len()) as u32;
    let prefix = [&len.to_le_bytes()[..], &[kind, topic, 0, 0], &received_ns.to_le_bytes()].concat();
    [&prefix[..], parts[0], parts[1]].concat().into()
}

pub(super) fn frame(topic: u8, received_ns: u64, header: &[u8], payload: &[u8]) -> Arc<[u8]> {
    packet(kind::FRAME, topic, received_ns, [header, payload])
}

pub(super) fn attached() -> Arc<[u8]> {
    packet(kind::ATTACHED, 0, 0, [&[], &[]])
}

pub(super) fn event(event: &Event) -> Arc<[u8]> {
    packet(kind::EVENT, 0, event.at_ns, [&serde_json::to_vec(event).unwrap_or_default(), &[]])
}

pub(super) fn line(line: &LogLine) -> Arc<[u8]> {
    packet(kind::LINE, 0, line.at_ns, [&serde_json::to_vec(line).unwrap_or_default(), &[]])
}

pub(super) fn marked(marked: &Marked) -> Arc<[u8]> {
    packet(kind::MARKED, 0, 0, [&serde_json::to_vec(marked).unwrap_or_default(), &[]])
}

/// The answer to a tool that is not attached.
#[must_use]
pub fn refused(why: &str) -> Arc<[u8]> {
    packet(kind::REFUSED, 0, 0, [why.as_bytes(), &[]])
}

pub(super) fn lost(lost: &Lost) -> Arc<[u8]> {
    packet(kind::LOST, lost.topic, 0, [&serde_json::to_vec(lost).unwrap_or_default(), &[]])
}

/// Why bytes are not an item.
#[derive(Debug, thiserror::Error)]
pub enum ItemError {
    /// The length, kind or topic is unknown.
    #[error("the tap sent something else: kind {kind}, topic {topic}, {len} bytes")]
    Unknown {
        /// The kind.
        kind: u8,
        /// The topic's number.
        topic: u8,
        /// Bytes of the body.
        len: usize,
    },
    /// The body is not a frame.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The body is not an event, line or loss.
    #[error("the tap sent no JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// The first item of a buffer with its length in bytes; `None` if it is not whole yet.
pub(super) fn take(buffer: &[u8]) -> Result<Option<(Item, usize)>, ItemError> {
    let Some((prefix, rest)) = buffer.split_at_checked(PREFIX) else { return Ok(None) };
    let len = u32::from_le_bytes([prefix[0], prefix[1], prefix[2], prefix[3]]) as usize;
    let (kind, topic) = (prefix[4], prefix[5]);
    let is_known = (kind::FRAME..=kind::REFUSED).contains(&kind) && usize::from(topic) < TABLE.topics.len();
    if len > ITEM_BYTES_MAX || !is_known {
        return Err(ItemError::Unknown { kind, topic, len });
    }
    let Some(body) = rest.get(..len) else { return Ok(None) };
    let received_ns = u64::from_le_bytes(prefix[8..].try_into().unwrap_or_default());
    let item = match kind {
        kind::FRAME => Item::Frame(Frame::read(topic, body.into(), received_ns)?),
        kind::EVENT => Item::Event(serde_json::from_slice(body)?),
        kind::LINE => Item::Line(serde_json::from_slice(body)?),
        kind::ATTACHED => Item::Attached,
        kind::MARKED => Item::Marked(serde_json::from_slice(body)?),
        kind::REFUSED => Item::Refused(String::from_utf8_lossy(body).into_owned()),
        _ => Item::Lost(serde_json::from_slice(body)?),
    };
    Ok(Some((item, PREFIX + len)))
}
