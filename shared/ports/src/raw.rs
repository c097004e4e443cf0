//! Unchecked frames as bytes, of topics whose elements are known by name and size alone: for the tap, and for
//! a program between a topic's writer and its readers.

use std::cell::{Cell, RefCell};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::Run;
use wire::{Header, Record, TABLE, TopicEntry};

use crate::added;
use crate::limits::{Limits, NODES_MAX};
use crate::transport::{Reader, Received, Shape, Writer};
use crate::wait::{Wakes, descriptor, wait};
use crate::{Node, PortError, Stop};

/// Initial memory for a frame of a declared topic; it grows in powers of two.
const BYTES_START: usize = 64 * 1024;
/// Deepest queue of a consumer.
const CONSUMER_DEPTH: usize = 2;

/// A topic without the type of its elements: a topic of the wire's table, or one that the pipeline file
/// declares.
#[derive(Clone, Debug)]
pub struct RawTopic {
    /// Its name.
    pub name: String,
    /// Size of an element in bytes.
    pub element_size: usize,
    /// An element, if the wire's table has its type.
    pub element: Option<&'static Record>,
    type_name: String,
    alignment: usize,
    /// Maximum number of elements, and the number that the first memory of a writer has room for.
    elements: [usize; 2],
    limits: Limits,
    /// The name in errors, which lives as long as the program.
    in_errors: &'static str,
}

impl From<&TopicEntry> for RawTopic {
    fn from(entry: &TopicEntry) -> Self {
        Self {
            name: entry.name.to_owned(),
            element_size: entry.element.size,
            element: Some(entry.element),
            type_name: entry.type_name.to_owned(),
            alignment: entry.element.align,
            elements: [entry.elements_max, entry.elements_start],
            limits: Limits {
                publishers_max: entry.publishers_max,
                subscribers_max: entry.subscribers_max,
                nodes_max: NODES_MAX,
                depth_max: entry.depth_max,
            },
            in_errors: entry.name,
        }
    }
}

impl RawTopic {
    /// The topic of this name in a run.
    #[must_use]
    pub fn of(run: &Run, name: &str) -> Option<Self> {
        if let Some(entry) = TABLE.topics.iter().find(|entry| entry.name == name) {
            return Some(entry.into());
        }
        let topic = run.topic(name)?;
        let known = TABLE.topics.iter().find(|entry| entry.type_name == topic.type_name);
        Some(Self {
            name: topic.name.clone(),
            element_size: topic.element_size,
            element: known.map(|entry| entry.element),
            type_name: topic.type_name.clone(),
            alignment: 1,
            elements: [usize::MAX, (BYTES_START / topic.element_size).max(1)],
            limits: added::LIMITS,
            in_errors: added::TOPIC,
        })
    }

    /// Maximum number of processes that publish at a time.
    #[must_use]
    pub const fn publishers_max(&self) -> usize {
        self.limits.publishers_max
    }
}

impl Node {
    /// Opens a topic for reading unchecked frames, with the deepest queue.
    ///
    /// # Errors
    /// [`PortError`] if all reader places of the topic are taken, its writer has created it with another
    /// type, or shared memory is short.
    pub fn raw_subscriber(&self, topic: &RawTopic) -> Result<RawSubscriber, PortError> {
        self.raw_reader(topic, &topic.name, topic.limits.depth_max).map(RawSubscriber)
    }

    fn raw_reader(&self, topic: &RawTopic, name: &str, depth: usize) -> Result<Reader, PortError> {
        Reader::open(self, name, &self.raw_shape(topic, name)?, depth)
    }

    /// The settings of a topic, under its own name or an injector's.
    pub(crate) fn raw_shape(&self, topic: &RawTopic, name: &str) -> Result<Shape, PortError> {
        let RawTopic { type_name, element_size, alignment, limits, in_errors, .. } = topic;
        let element =
            TypeDetail::__internal_new_from_parts(TypeVariant::Dynamic, type_name, *element_size, *alignment);
        Ok(self.shape_of(in_errors, element.map_err(PortError::of("type name", in_errors))?, name, *limits))
    }
}

/// Reads a topic as an additional consumer and checks nothing; dropping it frees the reader's place.
#[derive(Debug)]
pub struct RawSubscriber(Reader);

/// A received frame; its header and its elements are unchecked.
#[derive(Debug)]
pub struct RawFrame(Received);

impl RawFrame {
    /// The header, unchecked.
    #[must_use]
    pub fn header(&self) -> &Header {
        self.0.header()
    }

    /// The bytes of its elements.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        self.0.bytes()
    }
}

impl RawSubscriber {
    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<RawFrame>, PortError> {
        Ok(self.0.receive()?.map(RawFrame))
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn drain(&self) -> Result<(), PortError> {
        self.0.drain()
    }
}

impl Wakes for RawSubscriber {
    fn listener(&self) -> &Listener<ipc::Service> {
        self.0.listener()
    }
}

/// Readable when an event of the topic has arrived, for programs that also wait for other things.
impl AsFd for RawSubscriber {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor(self)
    }
}

/// Receives frames of a topic under one name and sends frames under the topic's own name, with any header and
/// any elements.
#[derive(Debug)]
pub struct Relay {
    topic: RawTopic,
    /// `false` if the relay only reads.
    writes: bool,
    writer: RefCell<Option<Writer>>,
    /// Whether the name that the relay reads had a writer at the last check.
    had_writer: Cell<bool>,
    reader: Reader,
    node: Node,
}

impl Relay {
    /// Reads what is written under `name`, and writes to the readers of the topic.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(run: &Run, topic: RawTopic, name: &str) -> Result<Self, PortError> {
        let node = Node::open(run, "injector")?;
        let reader = node.raw_reader(&topic, name, topic.limits.depth_max)?;
        let relay = Self { topic, writes: true, writer: None.into(), had_writer: false.into(), reader, node };
        relay.open_writer()?;
        Ok(relay)
    }

    /// Only reads the topic, as an additional consumer.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn consumer(run: &Run, topic: RawTopic) -> Result<Self, PortError> {
        let node = Node::open(run, "consumer")?;
        let depth = topic.limits.depth_max.min(CONSUMER_DEPTH);
        let reader = node.raw_reader(&topic, &topic.name, depth)?;
        Ok(Self { topic, writes: false, writer: None.into(), had_writer: false.into(), reader, node })
    }

    /// Opens the topic for writing under its own name.
    fn open_writer(&self) -> Result<(), PortError> {
        let Self { topic, node, .. } = self;
        let writer =
            Writer::open(node, &topic.name, &node.raw_shape(topic, &topic.name)?, topic.elements[1])?;
        self.writer.replace(Some(writer));
        Ok(())
    }

    /// Keeps the topic open for writing while the name that is read has a writer. The topic's readers then
    /// notice when that writer dies. The topic stays open until the first writer has appeared.
    ///
    /// # Errors
    /// [`PortError`] if the topic can't be opened again.
    pub fn follow_writer(&self) -> Result<(), PortError> {
        let has_writer = self.reader.has_publisher();
        if self.had_writer.replace(has_writer) && !has_writer {
            self.writer.replace(None);
        } else if has_writer && self.writes && self.writer.borrow().is_none() {
            self.open_writer()?;
        }
        Ok(())
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails, or if the caller holds more frames than a reader may hold.
    pub fn receive(&self) -> Result<Option<RawFrame>, PortError> {
        Ok(self.reader.receive()?.map(RawFrame))
    }

    /// Sends a frame; elements over the topic's maximum and bytes after the last whole element are left out.
    /// A relay that has closed the topic ([`Relay::follow_writer`]) or that only reads sends nothing.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, header: &Header, payload: &[u8]) -> Result<(), PortError> {
        let writer = self.writer.borrow();
        let Some(writer) = writer.as_ref() else { return Ok(()) };
        let len = (payload.len() / self.topic.element_size).min(self.topic.elements[0]);
        let mut loan = writer.loan(len)?;
        loan.bytes_mut().copy_from_slice(&payload[..len * self.topic.element_size]);
        writer.send(loan, header)?;
        writer.notify();
        Ok(())
    }

    /// Sleeps until a frame arrives, a signal arrives or `timeout` has passed. May return early.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        wait([&self.reader as _], timeout)
    }

    /// The signals that ask the process to end.
    #[must_use]
    pub const fn stop(&self) -> &Stop {
        self.node.stop()
    }
}
