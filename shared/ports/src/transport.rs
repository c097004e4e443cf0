//! The transport, without the types of payloads: the two services of a topic and their ports.
//!
//! The code of the transport is generic. With a topic's own type it would be compiled for each topic, in each
//! stage. Here elements are bytes, so it is compiled once. The transport still compares name and size of the
//! element types ([`Shape::element`]).
#![expect(
    unsafe_code,
    reason = "the transport hands out memory of types that it knows by name and size only"
)]

use std::fmt::Debug;
use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::sample_mut::SampleMut;
use iceoryx2::service::builder;
use iceoryx2::service::marker::{CustomHeaderMarker, CustomPayloadMarker};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use wire::Header;

use crate::element::Head;
use crate::limits::Limits;
use crate::node::{
    ALIGNMENT, BORROWED_MAX, HISTORY, LOANED_MAX, SERVICES, event_id, is_half_made_topic, subscriber,
};
use crate::wait::{Wakes, drain};
use crate::{Node, PortError};

/// What all processes must agree on to open a topic.
#[derive(Debug)]
pub(crate) struct Shape {
    /// The topic's name in errors.
    pub topic: &'static str,
    /// Name, size and alignment of an element.
    pub element: TypeDetail,
    pub limits: Limits,
    /// The interval between two frames.
    pub interval: Duration,
}

/// The two services of a topic: frames, whose header is seen as `H`, and events.
#[derive(Debug)]
pub(crate) struct Services<H: Debug + ZeroCopySend> {
    frames: publish_subscribe::PortFactory<ipc::Service, [CustomPayloadMarker], H>,
    events: event::PortFactory<ipc::Service>,
}

/// The builder of the frame service.
type Building<H> = builder::publish_subscribe::Builder<[CustomPayloadMarker], H, ipc::Service>;

impl Services<Head> {
    /// Opens or creates the services of a topic, by its name in shared memory.
    pub fn open(node: &Node, name: &str, shape: &Shape) -> Result<Self, PortError> {
        Self::with(node, name, shape, |builder| builder.user_header::<Head>())
    }
}

impl<H: Debug + ZeroCopySend> Services<H> {
    fn with(
        node: &Node,
        name: &str,
        shape: &Shape,
        with_header: impl Fn(Building<()>) -> Building<H>,
    ) -> Result<Self, PortError> {
        let Shape { topic, element, limits, interval } = shape;
        let name = format!("{SERVICES}{name}");
        let name: ServiceName = name.as_str().try_into().map_err(PortError::of("service name", topic))?;
        let alignment = Alignment::new(ALIGNMENT).expect("64 is a power of two");
        let frames = || {
            let builder = node.node.service_builder(&name).publish_subscribe::<[CustomPayloadMarker]>();
            // SAFETY: the transport compares name and size across processes, and this module accesses the
            // elements only as bytes.
            let builder = unsafe { builder.__internal_set_payload_type_details(element) };
            with_header(builder)
                .payload_alignment(alignment)
                .max_publishers(limits.publishers_max)
                .max_subscribers(limits.subscribers_max)
                .max_nodes(limits.nodes_max)
                .subscriber_max_buffer_size(limits.depth_max)
                .subscriber_max_borrowed_samples(BORROWED_MAX)
                .history_size(HISTORY)
                .enable_safe_overflow(true)
                .open_or_create()
        };
        let frames = node.patiently(frames, is_half_made_topic).map_err(PortError::of("frames", topic))?;
        Ok(Self { frames, events: node.events(&name, *limits, *interval, topic)? })
    }
}

/// The writing end of a topic.
#[derive(Debug)]
pub(crate) struct Writer {
    publisher: Publisher<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>,
    notifier: Notifier<ipc::Service>,
    topic: &'static str,
}

/// Space for one frame in shared memory.
#[derive(Debug)]
pub(crate) struct Loaned(SampleMut<ipc::Service, [CustomPayloadMarker], CustomHeaderMarker>);

impl Writer {
    /// Opens a topic for writing. Its memory starts with room for a frame of `start_len` elements, and grows.
    pub fn open(node: &Node, name: &str, shape: &Shape, start_len: usize) -> Result<Self, PortError> {
        let header = TypeDetail::new::<Head>(TypeVariant::FixedSize);
        let Services { frames, events } = Services::with(node, name, shape, |builder| {
            let builder = builder.user_header::<CustomHeaderMarker>();
            // SAFETY: name, size and alignment match the header that `Loaned::send` writes.
            unsafe { builder.__internal_set_user_header_type_details(&header) }
        })?;
        let publisher = frames
            .publisher_builder()
            .max_loaned_samples(LOANED_MAX)
            .initial_max_slice_len(start_len)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(PortError::of("publisher", shape.topic))?;
        let notifier = events.notifier_builder().default_event_id(EventId::new(event_id::FRAME)).create();
        let notifier = notifier.map_err(PortError::of("notifier", shape.topic))?;
        Ok(Self { publisher, notifier, topic: shape.topic })
    }

    /// Space for `len` elements. Until they are written they hold an earlier frame or zeros.
    pub fn loan(&self, len: usize) -> Result<Loaned, PortError> {
        // SAFETY: the variant of the topics' types is dynamic, and `len` elements are handed out below.
        let loan = unsafe { self.publisher.loan_custom_payload(len) };
        let loan = loan.map_err(PortError::of("loan", self.topic))?;
        // SAFETY: the memory is a mapping that the kernel zeroed, or holds an earlier frame: its bytes are
        // defined, and a marker is one byte of any value.
        Ok(Loaned(unsafe { loan.assume_init() }))
    }

    /// Sends a frame to all readers without waking them.
    pub fn send(&self, mut loan: Loaned, header: &Header) -> Result<(), PortError> {
        let place: *mut CustomHeaderMarker = loan.0.user_header_mut();
        // SAFETY: the marker is at the place of the header, whose size and alignment the topic was opened
        // with.
        unsafe { place.cast::<Head>().write(Head(*header)) };
        loan.0.send().map_err(PortError::of("sending", self.topic))?;
        Ok(())
    }

    /// Wakes all readers.
    pub fn notify(&self) {
        // Errors here come from late notifications, which were still delivered, and from readers that have
        // ended.
        let _ = self.notifier.notify();
    }
}

impl Loaned {
    /// The bytes of the elements.
    pub fn bytes(&self) -> &[u8] {
        bytes_of(self.0.payload())
    }

    /// The bytes of the elements, to be written.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        let bytes = self.0.payload_mut();
        // SAFETY: a marker is one byte of any value, and the slice has one marker for each byte of the
        // elements.
        unsafe { std::slice::from_raw_parts_mut(bytes.as_mut_ptr().cast(), bytes.len()) }
    }
}

/// The reading end of a topic. It checks nothing.
#[derive(Debug)]
pub(crate) struct Reader {
    subscriber: Subscriber<ipc::Service, [CustomPayloadMarker], Head>,
    listener: Listener<ipc::Service>,
    services: Services<Head>,
    topic: &'static str,
}

/// A frame in shared memory; dropping it frees the memory.
#[derive(Debug)]
pub(crate) struct Received(Sample<ipc::Service, [CustomPayloadMarker], Head>);

impl Reader {
    /// Opens a topic for reading with a queue of `depth` frames.
    pub fn open(node: &Node, name: &str, shape: &Shape, depth: usize) -> Result<Self, PortError> {
        let services = Services::open(node, name, shape)?;
        let Services { frames, events } = &services;
        let create = || frames.subscriber_builder().buffer_size(depth).create();
        let most = frames.static_config().max_subscribers();
        let subscriber = subscriber(create, frames.name(), most, shape.topic)?;
        let listener = events.listener_builder().create().map_err(PortError::of("listener", shape.topic))?;
        Ok(Self { subscriber, listener, services, topic: shape.topic })
    }

    /// The oldest frame of the queue, if there is one.
    pub fn receive(&self) -> Result<Option<Received>, PortError> {
        Ok(self.subscriber.receive().map_err(PortError::of("receiving", self.topic))?.map(Received))
    }

    /// Whether frames are in the queue.
    pub fn has_frames(&self) -> bool {
        self.subscriber.has_samples().unwrap_or(false)
    }

    /// Whether a process has the topic open for writing. A dead writer counts until the launcher has cleaned
    /// up after it.
    pub fn has_publisher(&self) -> bool {
        self.services.frames.dynamic_config().number_of_publishers() > 0
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    pub fn drain(&self) -> Result<(), PortError> {
        drain(&self.listener)
    }
}

impl Wakes for Reader {
    fn listener(&self) -> &Listener<ipc::Service> {
        &self.listener
    }
}

impl Received {
    /// The header, unchecked.
    pub fn header(&self) -> &Header {
        &self.0.user_header().0
    }

    /// The bytes of the elements.
    pub fn bytes(&self) -> &[u8] {
        bytes_of(self.0.payload())
    }
}

/// The bytes of a payload.
fn bytes_of(payload: &[CustomPayloadMarker]) -> &[u8] {
    // SAFETY: a marker is one byte, and the slice has one marker for each byte of the elements.
    unsafe { std::slice::from_raw_parts(payload.as_ptr().cast(), payload.len()) }
}
