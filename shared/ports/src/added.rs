//! Topics that the pipeline file declares. Their types are known only at run time, by name and size.
#![expect(
    unsafe_code,
    reason = "the transport is told the name and size of a type that this program does not have"
)]

use std::fmt::Debug;
use std::os::fd::{AsFd, BorrowedFd};

use iceoryx2::port::listener::Listener;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::builder;
use iceoryx2::service::marker::CustomPayloadMarker;
use iceoryx2::service::port_factory::{event, publish_subscribe};
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::{Run, TopicRun, injected_topic};
use wire::Header;

use crate::element::Head;
use crate::node::{ALIGNMENT, BORROWED_MAX, HISTORY, NODES_MAX, is_half_made_topic, subscriber};
use crate::wait::{Wakes, descriptor, drain};
use crate::{Node, PortError};

/// Deepest queue of a topic that the pipeline file declares.
const DEPTH_MAX: usize = 8;
/// Readers of a declared topic besides the stages: the recorder, the launcher, the tap, an injector and two
/// more.
const TOOLS_MAX: usize = 6;
/// The topic name in errors about declared topics: errors hold names that live as long as the program.
pub(crate) const TOPIC: &str = "added by the pipeline file";

/// Maximum numbers of ports of a topic, and its maximum queue depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub publishers_max: usize,
    pub subscribers_max: usize,
    pub nodes_max: usize,
    pub depth_max: usize,
}

/// What the pipeline file adds to the shipped stages and topics.
#[derive(Debug)]
pub(crate) struct Added {
    pub stages_len: usize,
    topics: Vec<TopicRun>,
    /// Names of the topics that the added stages read. A topic that n stages read is in the list n times.
    reads: Vec<String>,
    /// Number of stages that read each declared topic.
    readers: Vec<usize>,
}

impl Added {
    pub fn of(run: &Run) -> Self {
        Self {
            stages_len: run.added().count(),
            reads: run.added().flat_map(|(_, stage)| stage.reads.clone()).collect(),
            readers: run.topics.iter().map(|topic| run.readers(&topic.name).count()).collect(),
            topics: run.topics.clone(),
        }
    }

    /// The declared topic with this name in shared memory. The name may be the topic's own or an injector's.
    pub fn topic(&self, name: &str) -> Option<&TopicRun> {
        let find = |name| self.topics.iter().find(|topic| topic.name == name);
        find(name).or_else(|| find(injected_topic(name)?))
    }

    /// How many added stages read a topic.
    pub fn readers_len(&self, topic: &str) -> usize {
        self.reads.iter().filter(|read| *read == topic).count()
    }

    /// The limits of a declared topic.
    pub fn limits(&self, topic: &TopicRun) -> Limits {
        let readers = self.topics.iter().zip(&self.readers).find(|(other, _)| other.name == topic.name);
        Limits {
            publishers_max: 1,
            subscribers_max: TOOLS_MAX + readers.map_or(0, |(_, len)| *len),
            nodes_max: NODES_MAX + self.stages_len,
            depth_max: DEPTH_MAX,
        }
    }
}

/// Reads a topic that the pipeline file declares. It checks nothing and sees the elements only as bytes.
#[derive(Debug)]
pub struct AddedSubscriber {
    subscriber: Subscriber<ipc::Service, [CustomPayloadMarker], Head>,
    listener: Listener<ipc::Service>,
}

/// The two services of a declared topic: frames and events.
pub(crate) type AddedServices<H> = (
    publish_subscribe::PortFactory<ipc::Service, [CustomPayloadMarker], H>,
    event::PortFactory<ipc::Service>,
);
/// The builder of the frame service.
pub(crate) type Building<H> = builder::publish_subscribe::Builder<[CustomPayloadMarker], H, ipc::Service>;

/// A frame of a declared topic.
#[derive(Debug)]
pub struct AddedFrame(Sample<ipc::Service, [CustomPayloadMarker], Head>);

impl Node {
    /// Opens a topic that the pipeline file declares for reading, by its name in the run's record.
    ///
    /// # Errors
    /// [`PortError`] if all reader places of the topic are taken, its writer has created it with another
    /// type, or shared memory is short.
    pub fn added_subscriber(&self, topic: &TopicRun) -> Result<AddedSubscriber, PortError> {
        let services = self.added_services(topic, &topic.name, |builder| builder.user_header::<Head>())?;
        AddedSubscriber::of(&services)
    }

    /// Opens or creates the two services of a topic that the pipeline file declares, under its own name or an
    /// injector's. `with_header` sets how this process sees the header.
    pub(crate) fn added_services<H: Debug + ZeroCopySend>(
        &self,
        topic: &TopicRun,
        name: &str,
        with_header: impl Fn(Building<()>) -> Building<H>,
    ) -> Result<AddedServices<H>, PortError> {
        let limits = self.with_further(name, self.added.limits(topic));
        let name = format!("stgdat/{name}");
        let name: ServiceName = name.as_str().try_into().map_err(PortError::of("service name", TOPIC))?;
        let element = TypeDetail::__internal_new_from_parts(
            TypeVariant::Dynamic,
            &topic.type_name,
            topic.element_size,
            1,
        )
        .map_err(PortError::of("type name", TOPIC))?;
        let alignment = Alignment::new(ALIGNMENT).expect("64 is a power of two");
        let frames = || {
            let builder = self.node.service_builder(&name).publish_subscribe::<[CustomPayloadMarker]>();
            // SAFETY: the transport compares name and size with those of the other processes, and this
            // program reads and writes the elements only as bytes.
            let builder = unsafe { builder.__internal_set_payload_type_details(&element) };
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
        let frames = self.patiently(frames, is_half_made_topic).map_err(PortError::of("frames", TOPIC))?;
        Ok((frames, self.events(&name, limits, self.interval, TOPIC)?))
    }
}

/// Reads the headers of added stages whose output no forecast waits for: the forecasts' headers do not
/// contain their hops.
#[derive(Debug)]
pub struct Beside(Vec<AddedSubscriber>);

impl Beside {
    /// Opens one output topic of each of these stages.
    ///
    /// # Errors
    /// As [`Node::added_subscriber`].
    pub fn open(node: &Node, run: &Run) -> Result<Self, PortError> {
        let stages = run.beside();
        let stages = stages.iter().filter_map(|stage| run.stage(*stage));
        let topics = stages.filter_map(|stage| stage.writes.iter().find_map(|topic| run.topic(topic)));
        topics.map(|topic| node.added_subscriber(topic)).collect::<Result<_, _>>().map(Self)
    }

    /// The headers that have arrived, unchecked.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn take(&self) -> Result<Vec<Header>, PortError> {
        let mut headers = Vec::new();
        for topic in &self.0 {
            topic.drain()?;
            while let Some(frame) = topic.receive()? {
                headers.push(*frame.header());
            }
        }
        Ok(headers)
    }
}

impl AddedSubscriber {
    /// The reading ends of a topic's services.
    pub(crate) fn of((frames, events): &AddedServices<Head>) -> Result<Self, PortError> {
        let create = || frames.subscriber_builder().buffer_size(DEPTH_MAX).create();
        Ok(Self {
            subscriber: subscriber(create, frames.name(), frames.static_config().max_subscribers(), TOPIC)?,
            listener: events.listener_builder().create().map_err(PortError::of("listener", TOPIC))?,
        })
    }

    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<AddedFrame>, PortError> {
        Ok(self.subscriber.receive().map_err(PortError::of("receiving", TOPIC))?.map(AddedFrame))
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn drain(&self) -> Result<(), PortError> {
        drain(&self.listener)
    }
}

impl AddedFrame {
    /// The header, unchecked.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.0.user_header().0
    }

    /// The bytes of its elements.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        let bytes = self.0.payload();
        // SAFETY: a marker is one byte, and the transport reports the length of the slice as the total size
        // of the elements.
        unsafe { std::slice::from_raw_parts(bytes.as_ptr().cast(), bytes.len()) }
    }
}

impl Wakes for AddedSubscriber {
    fn listener(&self) -> &Listener<ipc::Service> {
        &self.listener
    }
}

/// Readable when an event of the topic has arrived, for programs that also wait for other things.
impl AsFd for AddedSubscriber {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor(self)
    }
}
