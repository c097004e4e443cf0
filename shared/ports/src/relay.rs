//! Unchecked frames in shared memory, for a program between a topic's writer and its readers.
#![expect(unsafe_code, reason = "a loan hands out shared memory that was never written by this process")]

use std::cell::{Cell, RefCell};
use std::time::Duration;

use bytemuck::TransparentWrapper;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::PortFactory as _;
use run::Run;
use wire::{Header, Topic};

use crate::element::{Element, Head};
use crate::node::{Services, Writing, publisher_of, subscriber_of};
use crate::wait::{Wakes, wait};
use crate::{Node, PortError, Stop};

/// Receives frames of a topic under one name and sends frames under the topic's own name, with any header and
/// any payload.
#[derive(Debug)]
pub struct Relay<T: Topic> {
    /// `false` if the relay only reads.
    writes: bool,
    writer: RefCell<Option<Writing<T>>>,
    /// Whether the name that the relay reads had a writer at the last check.
    had_writer: Cell<bool>,
    services: Services<T>,
    subscriber: Subscriber<ipc::Service, [Element<T>], Head>,
    listener: Listener<ipc::Service>,
    node: Node,
}

/// A received frame; its header and its elements are unchecked.
#[derive(Debug)]
pub struct RawFrame<T: Topic>(Sample<ipc::Service, [Element<T>], Head>);

impl<T: Topic> RawFrame<T> {
    pub(crate) const fn of(sample: Sample<ipc::Service, [Element<T>], Head>) -> Self {
        Self(sample)
    }

    /// The header, unchecked.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.0.user_header().0
    }

    /// The elements.
    #[must_use]
    pub fn elements(&self) -> &[T::Element] {
        Element::<T>::peel_slice(self.0.payload())
    }
}

impl<T: Topic> Relay<T> {
    /// Reads what is written under `name`, and writes to the readers of the topic.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(run: &Run, name: &str) -> Result<Self, PortError> {
        let node = Node::open(run, "injector")?;
        let services = node.services::<T>(name)?;
        let (subscriber, listener) = subscriber_of::<T>(&services, T::DEPTH_MAX)?;
        let writer = RefCell::new(Some(publisher_of::<T>(&node.services::<T>(T::NAME)?)?));
        Ok(Self { writes: true, writer, had_writer: Cell::new(false), services, subscriber, listener, node })
    }

    /// Only reads the topic, as an additional consumer, with a queue of `depth` frames.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn consumer(run: &Run, depth: usize) -> Result<Self, PortError> {
        let node = Node::open(run, "consumer")?;
        let services = node.services::<T>(T::NAME)?;
        let (subscriber, listener) = subscriber_of::<T>(&services, depth)?;
        let (writer, had_writer) = (RefCell::new(None), Cell::new(false));
        Ok(Self { writes: false, writer, had_writer, services, subscriber, listener, node })
    }

    /// Keeps the topic open for writing while the name that is read has a writer, so that the topic's readers
    /// see the end of a writer that dies. The topic stays open until the first writer has appeared.
    ///
    /// # Errors
    /// [`PortError`] if the topic can't be opened again.
    pub fn follow_writer(&self) -> Result<(), PortError> {
        let has_writer = self.services.0.dynamic_config().number_of_publishers() > 0;
        if self.had_writer.replace(has_writer) && !has_writer {
            self.writer.replace(None);
        } else if has_writer && self.writes && self.writer.borrow().is_none() {
            self.writer.replace(Some(publisher_of::<T>(&self.node.services::<T>(T::NAME)?)?));
        }
        Ok(())
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails, or if the caller holds more frames than a reader may hold.
    pub fn receive(&self) -> Result<Option<RawFrame<T>>, PortError> {
        let sample = self.subscriber.receive().map_err(PortError::of("receiving", T::NAME))?;
        Ok(sample.map(RawFrame))
    }

    /// Sends a frame; elements after [`Topic::ELEMENTS_MAX`] are left out. A relay that has closed the topic
    /// ([`Relay::follow_writer`]) or that only reads sends nothing.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, header: &Header, elements: &[T::Element]) -> Result<(), PortError> {
        let writer = self.writer.borrow();
        let Some((publisher, notifier)) = writer.as_ref() else { return Ok(()) };
        let elements = &elements[..elements.len().min(T::ELEMENTS_MAX)];
        let loan = publisher.loan_slice_uninit(elements.len()).map_err(PortError::of("loan", T::NAME))?;
        // SAFETY: the memory is a mapping that the kernel zeroed, or holds an earlier frame: its bytes are
        // defined, and any bit pattern is a value of a `Pod` element.
        let mut loan = unsafe { loan.assume_init() };
        Element::<T>::peel_slice_mut(loan.payload_mut()).copy_from_slice(elements);
        *loan.user_header_mut() = Head(*header);
        loan.send().map_err(PortError::of("sending", T::NAME))?;
        // Errors here are late notifications, which were delivered all the same, and readers that have ended.
        let _ = notifier.notify();
        Ok(())
    }

    /// Sleeps until a frame arrives, a signal arrives or `timeout` has passed. May return early.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        wait([self as &dyn Wakes], timeout)
    }

    /// The signals that ask the process to end.
    #[must_use]
    pub const fn stop(&self) -> &Stop {
        self.node.stop()
    }
}

impl<T: Topic> Wakes for Relay<T> {
    fn listener(&self) -> &Listener<ipc::Service> {
        &self.listener
    }
}
