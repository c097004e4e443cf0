//! Unchecked frames in shared memory, for a program between a topic's writer and its readers.

use std::cell::{Cell, RefCell};
use std::marker::PhantomData;
use std::time::Duration;

use bytemuck::{cast_slice, cast_slice_mut};
use run::Run;
use wire::{Header, Topic};

use crate::transport::{Reader, Received, Writer};
use crate::wait::wait;
use crate::{Node, PortError, Stop};

/// Receives frames of a topic under one name and sends frames under the topic's own name, with any header and
/// any payload.
#[derive(Debug)]
pub struct Relay<T: Topic> {
    /// `false` if the relay only reads.
    writes: bool,
    writer: RefCell<Option<Writer>>,
    /// Whether the name that the relay reads had a writer at the last check.
    had_writer: Cell<bool>,
    reader: Reader,
    node: Node,
    topic: PhantomData<T>,
}

/// A received frame; its header and its elements are unchecked.
#[derive(Debug)]
pub struct RawFrame<T: Topic>(Received, PhantomData<T>);

impl<T: Topic> RawFrame<T> {
    pub(crate) const fn of(frame: Received) -> Self {
        Self(frame, PhantomData)
    }

    /// The header, unchecked.
    #[must_use]
    pub fn header(&self) -> &Header {
        self.0.header()
    }

    /// The elements.
    #[must_use]
    pub fn elements(&self) -> &[T::Element] {
        cast_slice(self.0.bytes())
    }
}

impl<T: Topic> Relay<T> {
    /// Reads what is written under `name`, and writes to the readers of the topic.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(run: &Run, name: &str) -> Result<Self, PortError> {
        let node = Node::open(run, "injector")?;
        let reader = node.reader::<T>(name, T::DEPTH_MAX)?;
        let writer = RefCell::new(Some(node.writer::<T>(T::NAME)?));
        Ok(Self { writes: true, writer, had_writer: Cell::new(false), reader, node, topic: PhantomData })
    }

    /// Only reads the topic, as an additional consumer, with a queue of `depth` frames.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn consumer(run: &Run, depth: usize) -> Result<Self, PortError> {
        let node = Node::open(run, "consumer")?;
        let reader = node.reader::<T>(T::NAME, depth)?;
        let (writer, had_writer) = (RefCell::new(None), Cell::new(false));
        Ok(Self { writes: false, writer, had_writer, reader, node, topic: PhantomData })
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
            self.writer.replace(Some(self.node.writer::<T>(T::NAME)?));
        }
        Ok(())
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails, or if the caller holds more frames than a reader may hold.
    pub fn receive(&self) -> Result<Option<RawFrame<T>>, PortError> {
        Ok(self.reader.receive()?.map(RawFrame::of))
    }

    /// Sends a frame; elements after [`Topic::ELEMENTS_MAX`] are left out. A relay that has closed the topic
    /// ([`Relay::follow_writer`]) or that only reads sends nothing.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, header: &Header, elements: &[T::Element]) -> Result<(), PortError> {
        let writer = self.writer.borrow();
        let Some(writer) = writer.as_ref() else { return Ok(()) };
        let elements = &elements[..elements.len().min(T::ELEMENTS_MAX)];
        let mut loan = writer.loan(elements.len())?;
        cast_slice_mut(loan.bytes_mut()).copy_from_slice(elements);
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
