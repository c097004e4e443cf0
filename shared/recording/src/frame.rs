use std::sync::Arc;

use thiserror::Error;
use wire::{Header, Record, Rejected, SCHEMA, TABLE, Topic, TopicEntry};

/// Bytes of a header.
const HEADER: usize = size_of::<Header>();

/// One frame as it was sent: header and payload, unchecked but for their length.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    topic: u8,
    header: Box<Header>,
    received_ns: u64,
    /// Header and payload.
    bytes: Arc<[u8]>,
}

/// Why bytes are no frame.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FrameError {
    /// Fewer bytes than a header has.
    #[error("topic \"{topic}\": {found} bytes are no frame, a header alone has {HEADER}")]
    Short {
        /// The topic.
        topic: &'static str,
        /// Its bytes.
        found: usize,
    },
    /// The payload is not made of whole elements.
    #[error("topic \"{topic}\": a payload of {found} bytes, its elements have {element} each")]
    Uneven {
        /// The topic.
        topic: &'static str,
        /// Bytes of the payload.
        found: usize,
        /// Bytes of an element.
        element: usize,
    },
    /// Asked for as a frame of another topic.
    #[error("a frame of \"{found}\", not of \"{expected}\"")]
    OfTopic {
        /// Its topic.
        found: &'static str,
        /// The other.
        expected: &'static str,
    },
    /// The header is impossible.
    #[error("topic \"{topic}\", tick {tick}: {source}")]
    Rejected {
        /// The topic.
        topic: &'static str,
        /// The tick.
        tick: u64,
        /// What is wrong.
        source: Rejected,
    },
}

/// The number of a topic: its place in [`wire::TABLE`].
#[must_use]
pub fn topic_number(name: &str) -> Option<u8> {
    TABLE.topics.iter().position(|topic| topic.name == name).map(|place| place as u8)
}

impl Frame {
    /// A frame of header and elements, received at that time of `CLOCK_MONOTONIC`.
    ///
    /// # Panics
    /// Never: every topic is in the table.
    #[must_use]
    pub fn of<T: Topic>(header: &Header, elements: &[T::Element], received_ns: u64) -> Self {
        let bytes = [bytemuck::bytes_of(header), bytemuck::cast_slice(elements)].concat();
        let topic = topic_number(T::NAME).expect("every topic is in the table");
        Self { topic, header: Box::new(*header), received_ns, bytes: bytes.into() }
    }

    /// A frame of bytes.
    ///
    /// # Errors
    /// [`FrameError`] where their number is not that of a frame.
    ///
    /// # Panics
    /// Where there is no topic of that number.
    pub fn read(topic: u8, bytes: Arc<[u8]>, received_ns: u64) -> Result<Self, FrameError> {
        let entry = &TABLE.topics[usize::from(topic)];
        let Some((header, payload)) = bytes.split_at_checked(HEADER) else {
            return Err(FrameError::Short { topic: entry.name, found: bytes.len() });
        };
        if !payload.len().is_multiple_of(entry.element.size) {
            let (found, element) = (payload.len(), entry.element.size);
            return Err(FrameError::Uneven { topic: entry.name, found, element });
        }
        let header = Box::new(bytemuck::pod_read_unaligned(header));
        Ok(Self { topic, header, received_ns, bytes })
    }

    /// The topic's number: its place in [`wire::TABLE`].
    #[must_use]
    pub const fn number(&self) -> u8 {
        self.topic
    }

    /// The topic.
    #[must_use]
    pub fn topic(&self) -> &'static TopicEntry {
        &TABLE.topics[usize::from(self.topic)]
    }

    /// The record of its elements.
    #[must_use]
    pub fn element(&self) -> &'static Record {
        self.topic().element
    }

    /// The header, unchecked.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// When the tap took it from its queue, `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn received_ns(&self) -> u64 {
        self.received_ns
    }

    /// When its sender handed it over, `CLOCK_MONOTONIC`; the time of receipt where no stage did.
    #[must_use]
    pub fn sent_ns(&self) -> u64 {
        self.header.hops().last().map_or(self.received_ns, |hop| hop.sent_ns)
    }

    /// Header and payload.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The payload.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.bytes[HEADER..]
    }

    /// The elements of a frame of that topic, checked as far as their header says how many there are.
    ///
    /// # Errors
    /// [`FrameError`] where it is a frame of another topic, its header is impossible or has another number of
    /// elements.
    pub fn elements<T: Topic>(&self) -> Result<Vec<T::Element>, FrameError> {
        let found = self.topic().name;
        if found != T::NAME {
            return Err(FrameError::OfTopic { found, expected: T::NAME });
        }
        let parts = self.payload().chunks_exact(size_of::<T::Element>());
        let elements: Vec<T::Element> = parts.map(bytemuck::pod_read_unaligned).collect();
        let rejected = |source| FrameError::Rejected { topic: T::NAME, tick: self.header.seq, source };
        // A header of another schema has its counts elsewhere.
        if self.header.schema != SCHEMA {
            return Err(rejected(Rejected::Schema { found: self.header.schema, expected: SCHEMA }));
        }
        self.header.check().map_err(rejected)?;
        let (found, expected) = (elements.len(), T::elements_len(&self.header.counts));
        if found != expected {
            return Err(rejected(Rejected::Length { found, expected }));
        }
        Ok(elements)
    }
}
