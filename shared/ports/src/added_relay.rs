//! Unchecked frames, as bytes, of a topic that the pipeline file declares. For a program between the topic's
//! writer and its readers.

use std::cell::{Cell, RefCell};
use std::time::Duration;

use run::{Run, TopicRun};
use wire::Header;

use crate::transport::{Reader, Writer};
use crate::wait::wait;
use crate::{AddedFrame, Node, PortError, Stop};

/// Initial memory for a frame; it grows in powers of two.
const BYTES_START: usize = 64 * 1024;

/// Receives frames of a declared topic under one name and sends frames under the topic's own name, with any
/// header and any elements.
#[derive(Debug)]
pub struct AddedRelay {
    topic: TopicRun,
    writer: RefCell<Option<Writer>>,
    /// `false` if the relay only reads.
    writes: bool,
    /// Whether the name that the relay reads had a writer at the last check.
    had_writer: Cell<bool>,
    reader: Reader,
    node: Node,
}

impl AddedRelay {
    /// Reads what is written under `name`, and writes to the readers of the topic.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(run: &Run, topic: &TopicRun, name: &str) -> Result<Self, PortError> {
        let relay = Self::of(Node::open(run, "injector")?, topic, name, true)?;
        relay.writer.replace(Some(writer(&relay.node, topic)?));
        Ok(relay)
    }

    /// Only reads the topic, as one more consumer.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn consumer(run: &Run, topic: &TopicRun) -> Result<Self, PortError> {
        Self::of(Node::open(run, "consumer")?, topic, &topic.name, false)
    }

    fn of(node: Node, topic: &TopicRun, name: &str, writes: bool) -> Result<Self, PortError> {
        let reader = node.added_reader(topic, name)?;
        let (writer, had_writer, topic) = (RefCell::new(None), Cell::new(false), topic.clone());
        Ok(Self { topic, writer, writes, had_writer, reader, node })
    }

    /// Keeps the topic open for writing while the name that is read has a writer; see
    /// [`Relay::follow_writer`](crate::Relay::follow_writer).
    ///
    /// # Errors
    /// [`PortError`] if the topic can't be opened again.
    pub fn follow_writer(&self) -> Result<(), PortError> {
        let has_writer = self.reader.has_publisher();
        if self.had_writer.replace(has_writer) && !has_writer {
            self.writer.replace(None);
        } else if has_writer && self.writes && self.writer.borrow().is_none() {
            self.writer.replace(Some(writer(&self.node, &self.topic)?));
        }
        Ok(())
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails, or if the caller holds more frames than a reader may hold.
    pub fn receive(&self) -> Result<Option<AddedFrame>, PortError> {
        Ok(self.reader.receive()?.map(AddedFrame::of))
    }

    /// Sends a frame; bytes after the last whole element are left out. A relay that has closed the topic
    /// ([`AddedRelay::follow_writer`]) or that only reads sends nothing.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, header: &Header, payload: &[u8]) -> Result<(), PortError> {
        let writer = self.writer.borrow();
        let Some(writer) = writer.as_ref() else { return Ok(()) };
        let len = payload.len() / self.topic.element_size;
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

/// Opens the topic for writing under its own name.
fn writer(node: &Node, topic: &TopicRun) -> Result<Writer, PortError> {
    let start_len = (BYTES_START / topic.element_size).max(1);
    Writer::open(node, &topic.name, &node.added_shape(topic, &topic.name)?, start_len)
}
