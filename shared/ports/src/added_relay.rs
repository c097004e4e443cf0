//! Unchecked frames, as bytes, of a topic that the pipeline file declares. For a program between the topic's
//! writer and its readers.
#![expect(unsafe_code, reason = "the transport hands out memory of a type that this program does not have")]

use std::cell::{Cell, RefCell};
use std::mem::MaybeUninit;
use std::time::Duration;

use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::*;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::{Run, TopicRun};
use wire::Header;

use crate::added::{AddedServices, TOPIC};
use crate::element::Head;
use crate::node::{LOANED_MAX, event_id};
use crate::wait::wait;
use crate::{AddedFrame, AddedSubscriber, Node, PortError, Stop};

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
    subscriber: AddedSubscriber,
    services: AddedServices<Head>,
    node: Node,
}

/// The writing ends of a topic's services.
#[derive(Debug)]
struct Writer {
    publisher: Publisher<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>,
    notifier: Notifier<ipc::Service>,
}

impl AddedRelay {
    /// Reads what is written under `name`, and writes to the readers of the topic.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(run: &Run, topic: &TopicRun, name: &str) -> Result<Self, PortError> {
        let relay = Self::of(Node::open(run, "injector")?, topic, name, true)?;
        relay.writer.replace(Some(Writer::open(&relay.node, topic)?));
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
        let services = node.added_services(topic, name, |builder| builder.user_header::<Head>())?;
        let subscriber = AddedSubscriber::of(&services)?;
        let (writer, had_writer, topic) = (RefCell::new(None), Cell::new(false), topic.clone());
        Ok(Self { topic, writer, writes, had_writer, subscriber, services, node })
    }

    /// Keeps the topic open for writing while the name that is read has a writer; see
    /// [`Relay::follow_writer`](crate::Relay::follow_writer).
    ///
    /// # Errors
    /// [`PortError`] if the topic can't be opened again.
    pub fn follow_writer(&self) -> Result<(), PortError> {
        let has_writer = self.services.0.dynamic_config().number_of_publishers() > 0;
        if self.had_writer.replace(has_writer) && !has_writer {
            self.writer.replace(None);
        } else if has_writer && self.writes && self.writer.borrow().is_none() {
            self.writer.replace(Some(Writer::open(&self.node, &self.topic)?));
        }
        Ok(())
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails, or if the caller holds more frames than a reader may hold.
    pub fn receive(&self) -> Result<Option<AddedFrame>, PortError> {
        self.subscriber.receive()
    }

    /// Sends a frame; bytes after the last whole element are left out. A relay that has closed the topic
    /// ([`AddedRelay::follow_writer`]) or that only reads sends nothing.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, header: &Header, payload: &[u8]) -> Result<(), PortError> {
        match self.writer.borrow().as_ref() {
            Some(writer) => writer.send(header, payload, self.topic.element_size),
            None => Ok(()),
        }
    }

    /// Sleeps until a frame arrives, a signal arrives or `timeout` has passed. May return early.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        wait([&self.subscriber as _], timeout)
    }

    /// The signals that ask the process to end.
    #[must_use]
    pub const fn stop(&self) -> &Stop {
        self.node.stop()
    }
}

impl Writer {
    /// Opens the topic for writing under its own name.
    fn open(node: &Node, topic: &TopicRun) -> Result<Self, PortError> {
        let header = TypeDetail::new::<Head>(TypeVariant::FixedSize);
        let (frames, events) = node.added_services(topic, &topic.name, |builder| {
            let builder = builder.user_header::<CustomHeaderMarker>();
            // SAFETY: name, size and alignment are those of the header of all ports of the topic, and `send`
            // writes such a header.
            unsafe { builder.__internal_set_user_header_type_details(&header) }
        })?;
        let publisher = frames
            .publisher_builder()
            .max_loaned_samples(LOANED_MAX)
            .initial_max_slice_len((BYTES_START / topic.element_size).max(1))
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(PortError::of("publisher", TOPIC))?;
        let notifier = events.notifier_builder().default_event_id(EventId::new(event_id::FRAME)).create();
        Ok(Self { publisher, notifier: notifier.map_err(PortError::of("notifier", TOPIC))? })
    }

    fn send(&self, header: &Header, payload: &[u8], element_size: usize) -> Result<(), PortError> {
        let elements_len = payload.len() / element_size;
        // SAFETY: the topic's variant is dynamic, and the bytes of `elements_len` elements are written below.
        let loan = unsafe { self.publisher.loan_custom_payload(elements_len) };
        let mut loan = loan.map_err(PortError::of("loan", TOPIC))?;
        let bytes = payload[..elements_len * element_size].iter();
        for (place, byte) in loan.payload_mut().iter_mut().zip(bytes) {
            let place: *mut MaybeUninit<CustomPayloadMarker> = place;
            // SAFETY: a marker is one byte of memory that this process alone has until the frame is sent.
            unsafe { place.cast::<u8>().write(*byte) };
        }
        let place: *mut CustomHeaderMarker = loan.user_header_mut();
        // SAFETY: the marker is at the place of the header, whose size and alignment the topic was opened
        // with.
        unsafe { place.cast::<Head>().write(Head(*header)) };
        // SAFETY: all bytes of the elements and of the header have been written.
        let loan = unsafe { loan.assume_init() };
        loan.send().map_err(PortError::of("sending", TOPIC))?;
        // Errors here are late notifications, which were delivered all the same, and readers that have ended.
        let _ = self.notifier.notify();
        Ok(())
    }
}
