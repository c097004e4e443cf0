//! Reads topics that the pipeline file declares.

use std::os::fd::{AsFd, BorrowedFd};

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::{Run, TopicRun};
use wire::Header;

use crate::added::{DEPTH_MAX, TOPIC};
use crate::transport::{Reader, Received, Shape};
use crate::wait::{Wakes, descriptor};
use crate::{Node, PortError};

/// Reads a topic that the pipeline file declares. It checks nothing and sees the elements only as bytes.
#[derive(Debug)]
pub struct AddedSubscriber(Reader);

/// A frame of a declared topic.
#[derive(Debug)]
pub struct AddedFrame(Received);

impl Node {
    /// Opens a topic that the pipeline file declares for reading, by its name in the run's record.
    ///
    /// # Errors
    /// [`PortError`] if all reader places of the topic are taken, its writer has created it with another
    /// type, or shared memory is short.
    pub fn added_subscriber(&self, topic: &TopicRun) -> Result<AddedSubscriber, PortError> {
        self.added_reader(topic, &topic.name).map(AddedSubscriber)
    }

    /// Opens a declared topic for reading, under its own name or an injector's.
    pub(crate) fn added_reader(&self, topic: &TopicRun, name: &str) -> Result<Reader, PortError> {
        Reader::open(self, name, &self.added_shape(topic, name)?, DEPTH_MAX)
    }

    /// The settings of a declared topic, under its own name or an injector's.
    pub(crate) fn added_shape(&self, topic: &TopicRun, name: &str) -> Result<Shape, PortError> {
        let element = TypeDetail::__internal_new_from_parts(
            TypeVariant::Dynamic,
            &topic.type_name,
            topic.element_size,
            1,
        )
        .map_err(PortError::of("type name", TOPIC))?;
        let limits = self.with_further(name, self.added.limits(topic));
        Ok(Shape { topic: TOPIC, element, limits, interval: self.interval })
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
    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<AddedFrame>, PortError> {
        Ok(self.0.receive()?.map(AddedFrame))
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn drain(&self) -> Result<(), PortError> {
        self.0.drain()
    }
}

impl AddedFrame {
    pub(crate) const fn of(frame: Received) -> Self {
        Self(frame)
    }

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

impl Wakes for AddedSubscriber {
    fn listener(&self) -> &Listener<ipc::Service> {
        self.0.listener()
    }
}

/// Readable when an event of the topic has arrived, for programs that also wait for other things.
impl AsFd for AddedSubscriber {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor(self)
    }
}
