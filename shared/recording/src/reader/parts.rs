//! The parts and channels of a file.

use mcap::records::{self, Record, op};
use wire::TABLE;

use super::chunk::record;
use crate::format::{BEFORE, JSON, WIRE};
use crate::{About, EVENTS, LOG, topic_number};

/// Records that are read together.
#[derive(Debug)]
pub(super) struct Part {
    /// Time of the first message.
    pub begin_ns: u64,
    /// The first byte.
    pub at: u64,
    /// The first byte after the part.
    pub end: u64,
    pub content: Content,
}

/// The content of a part.
#[derive(Debug, PartialEq)]
pub(super) enum Content {
    Chunk,
    /// Messages outside of chunks.
    Loose,
    /// The part can't be read, with the reason.
    Damage(String),
}

/// The content of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    /// Frames of a topic, with the number of bytes per element.
    Topic(u8, usize),
    /// The same, for frames from before the recording.
    Before(u8, usize),
    Events,
    Log,
    /// Messages of another program.
    Foreign,
}

impl Channel {
    /// The content of a channel. Its number has no meaning: tools change it.
    pub fn of(channel: &records::Channel, about: &About) -> Self {
        match (channel.topic.as_str(), channel.message_encoding.as_str()) {
            (EVENTS, JSON) => return Self::Events,
            (LOG, JSON) => return Self::Log,
            (_, WIRE) => {}
            _ => return Self::Foreign,
        }
        let before = channel.topic.strip_prefix(BEFORE);
        let name = before.unwrap_or(&channel.topic);
        let Some(number) = topic_number(name) else { return Self::Foreign };
        let declared = channel.metadata.get("element_bytes").and_then(|bytes| bytes.parse().ok());
        let recorded = || about.element_bytes.get(name).copied().filter(|_| before.is_none());
        let bytes = declared.or_else(recorded).unwrap_or(TABLE.topics[usize::from(number)].element.size);
        if before.is_some() { Self::Before(number, bytes) } else { Self::Topic(number, bytes) }
    }
}

/// The channels that a sequence of records defines.
pub(super) fn channels(mut bytes: &[u8]) -> Vec<records::Channel> {
    std::iter::from_fn(|| record(&mut bytes)).filter_map(|(op, body)| channel(op, body)).collect()
}

pub(super) fn channel(op: u8, body: &[u8]) -> Option<records::Channel> {
    if op != op::CHANNEL {
        return None;
    }
    match mcap::parse_record(op, body) {
        Ok(Record::Channel(channel)) => Some(channel),
        _ => None,
    }
}
