use std::collections::BTreeMap;
use std::mem::offset_of;
use std::ops::Range;
use std::sync::Arc;

use thiserror::Error;
use wire::{Forecast, ForecastsTopic, Header, Record, Rejected, SCHEMA, TABLE, Topic, TopicEntry};

/// Bytes of a header.
const HEADER: usize = size_of::<Header>();

/// One frame as it was sent: header and payload. Only the length is checked. The frame may hold only the
/// leading bytes of each element.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    topic: u8,
    /// Bytes of each element.
    element_bytes: u32,
    header: Box<Header>,
    received_ns: u64,
    /// Header and payload.
    bytes: Arc<[u8]>,
}

/// Why bytes are not a frame.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FrameError {
    /// Fewer bytes than a header has.
    #[error("topic \"{topic}\": {found} bytes are no frame, a header alone has {HEADER}")]
    Short {
        /// The topic.
        topic: &'static str,
        /// Bytes.
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
    /// An element has fewer bytes than requested, or the request is for none.
    #[error("topic \"{topic}\": {found} bytes of each element, which has {element}")]
    Element {
        /// The topic.
        topic: &'static str,
        /// Requested bytes.
        found: usize,
        /// Bytes of an element.
        element: usize,
    },
    /// The frame belongs to another topic.
    #[error("a frame of \"{found}\", not of \"{expected}\"")]
    OfTopic {
        /// Topic.
        found: &'static str,
        /// The requested topic.
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

/// The bytes of [`Forecast::lanes`] in a forecast.
const LANES: Range<usize> = offset_of!(Forecast, lanes)..offset_of!(Forecast, lanes) + size_of::<u32>();

/// The number of a topic: its place in [`wire::TABLE`].
#[must_use]
pub fn topic_number(name: &str) -> Option<u8> {
    TABLE.topics.iter().position(|topic| topic.name == name).map(|place| place as u8)
}

/// Topics that by default record only the leading bytes of their elements, with the number of bytes.
/// Forecasts leave out the controls, which are half of their bytes and hardly compress.
#[must_use]
pub fn lean() -> BTreeMap<String, usize> {
    BTreeMap::from([(ForecastsTopic::NAME.to_owned(), offset_of!(Forecast, controls))])
}

impl Frame {
    /// A frame of header and elements, received at `received_ns` on `CLOCK_MONOTONIC`.
    ///
    /// # Panics
    /// Never: every topic is in the table.
    #[must_use]
    pub fn of<T: Topic>(header: &Header, elements: &[T::Element], received_ns: u64) -> Self {
        let bytes = [bytemuck::bytes_of(header), bytemuck::cast_slice(elements)].concat();
        let topic = topic_number(T::NAME).expect("every topic is in the table");
        let element_bytes = size_of::<T::Element>() as u32;
        Self { topic, element_bytes, header: Box::new(*header), received_ns, bytes: bytes.into() }
    }

    /// A frame from bytes with whole elements.
    ///
    /// # Errors
    /// [`FrameError`] if their number does not match a frame.
    ///
    /// # Panics
    /// If no topic has this number.
    pub fn read(topic: u8, bytes: Arc<[u8]>, received_ns: u64) -> Result<Self, FrameError> {
        Self::read_leading(topic, TABLE.topics[usize::from(topic)].element.size, bytes, received_ns)
    }

    /// A frame from bytes with only the leading bytes of each element.
    ///
    /// # Errors
    /// [`FrameError`] if their number does not match a frame.
    ///
    /// # Panics
    /// If no topic has this number.
    pub fn read_leading(
        topic: u8,
        element_bytes: usize,
        bytes: Arc<[u8]>,
        received_ns: u64,
    ) -> Result<Self, FrameError> {
        let entry = &TABLE.topics[usize::from(topic)];
        if !(1..=entry.element.size).contains(&element_bytes) {
            let (found, element) = (element_bytes, entry.element.size);
            return Err(FrameError::Element { topic: entry.name, found, element });
        }
        let Some((header, payload)) = bytes.split_at_checked(HEADER) else {
            return Err(FrameError::Short { topic: entry.name, found: bytes.len() });
        };
        if !payload.len().is_multiple_of(element_bytes) {
            let (found, element) = (payload.len(), element_bytes);
            return Err(FrameError::Uneven { topic: entry.name, found, element });
        }
        let header = Box::new(bytemuck::pod_read_unaligned(header));
        Ok(Self { topic, element_bytes: element_bytes as u32, header, received_ns, bytes })
    }

    /// The frame with at most `element_bytes` leading bytes of each element.
    #[must_use]
    pub fn leading(&self, element_bytes: usize) -> Self {
        if element_bytes >= self.element_bytes() {
            return self.clone();
        }
        let payload = self.payload().chunks_exact(self.element_bytes());
        let mut bytes = Vec::with_capacity(HEADER + payload.len() * element_bytes);
        bytes.extend_from_slice(&self.bytes[..HEADER]);
        payload.for_each(|element| bytes.extend_from_slice(&element[..element_bytes]));
        Self { element_bytes: element_bytes as u32, bytes: bytes.into(), ..self.clone() }
    }

    /// Whether a forecast of the frame has a nonzero [`Forecast::lanes`].
    pub(crate) fn has_lanes(&self) -> bool {
        let mut elements = self.payload().chunks_exact(self.element_bytes());
        self.topic().name == ForecastsTopic::NAME
            && elements
                .any(|element| element.get(LANES).is_some_and(|lanes| lanes.iter().any(|byte| *byte != 0)))
    }

    /// The frame of forecasts with zeros for [`Forecast::lanes`].
    pub(crate) fn without_lanes(&self) -> Self {
        let mut bytes = self.bytes.to_vec();
        for element in bytes[HEADER..].chunks_exact_mut(self.element_bytes()) {
            element.get_mut(LANES).into_iter().for_each(|lanes| lanes.fill(0));
        }
        Self { bytes: bytes.into(), ..self.clone() }
    }

    /// The topic's number: its place in [`wire::TABLE`].
    pub const fn number(&self) -> u8 {
        self.topic
    }

    /// The topic.
    pub fn topic(&self) -> &'static TopicEntry {
        &TABLE.topics[usize::from(self.topic)]
    }

    /// The record of its elements.
    pub fn element(&self) -> &'static Record {
        self.topic().element
    }

    /// Number of recorded bytes of each element.
    pub const fn element_bytes(&self) -> usize {
        self.element_bytes as usize
    }

    /// Number of its elements.
    pub fn elements_len(&self) -> usize {
        self.payload().len() / self.element_bytes()
    }

    /// The header, unchecked.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// When the tap took the frame from its queue, on `CLOCK_MONOTONIC`.
    pub const fn received_ns(&self) -> u64 {
        self.received_ns
    }

    /// When its sender sent it, on `CLOCK_MONOTONIC`; the time of receipt if no stage stamped it.
    pub fn sent_ns(&self) -> u64 {
        self.header.hops().last().map_or(self.received_ns, |hop| hop.sent_ns)
    }

    /// Header and payload.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The payload.
    pub fn payload(&self) -> &[u8] {
        &self.bytes[HEADER..]
    }

    /// The elements of a frame of topic `T`. Their number is checked against the header. Bytes that the frame
    /// does not hold are zero.
    ///
    /// # Errors
    /// [`FrameError`] if the frame belongs to another topic, or if its header is impossible or states another
    /// number of elements.
    pub fn elements<T: Topic>(&self) -> Result<Vec<T::Element>, FrameError> {
        let found = self.topic().name;
        if found != T::NAME {
            return Err(FrameError::OfTopic { found, expected: T::NAME });
        }
        let parts = self.payload().chunks_exact(self.element_bytes());
        let whole = |part: &[u8]| {
            let mut element: T::Element = bytemuck::Zeroable::zeroed();
            bytemuck::bytes_of_mut(&mut element)[..part.len()].copy_from_slice(part);
            element
        };
        let elements: Vec<T::Element> = parts.map(whole).collect();
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
