//! Opens the topics of a node.

use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::Run;
use wire::{HeartbeatsTopic, TABLE, Topic};

use crate::element::{Element, Head};
use crate::limits::{HEARTBEAT, Limits, NODES_MAX};
use crate::transport::{Reader, Services, Shape, Writer};
use crate::{Node, PortError, Publisher, Subscriber};

impl Node {
    /// Opens a topic for writing.
    ///
    /// # Errors
    /// [`PortError`] if all writer places of the topic are taken or shared memory is short.
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, PortError> {
        Ok(Publisher::new(self.writer::<T>(self.names.of(T::NAME))?, self.sender, self.protects::<T>()))
    }

    /// Opens a topic for reading with a queue of `depth` frames; the oldest is dropped when it is full.
    ///
    /// # Errors
    /// [`PortError`] if all reader places of the topic are taken, shared memory is short, or `depth` is more
    /// than [`Topic::DEPTH_MAX`].
    pub fn subscriber<T: Topic>(&self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let reader = self.reader::<T>(self.names.of(T::NAME), depth)?;
        Ok(Subscriber::new(reader, self.run_id, self.protects::<T>(), self.lockstep))
    }

    /// Whether the frames of the topic carry a check value.
    fn protects<T: Topic>(&self) -> bool {
        // A declared topic has no check value: its readers may know it by another name, and the check value
        // covers the name.
        self.added.topic(self.names.of(T::NAME)).is_none()
            && self.protected.iter().any(|name| name == T::NAME)
    }

    /// Opens a topic for writing, by its name in shared memory.
    pub(crate) fn writer<T: Topic>(&self, name: &str) -> Result<Writer, PortError> {
        Writer::open(self, name, &self.shape::<T>(name), T::ELEMENTS_START)
    }

    /// Opens a topic for reading, by its name in shared memory.
    pub(crate) fn reader<T: Topic>(&self, name: &str, depth: usize) -> Result<Reader, PortError> {
        Reader::open(self, name, &self.shape::<T>(name), depth)
    }

    /// The settings of a topic, by its name in shared memory. They are the same in all processes.
    fn shape<T: Topic>(&self, name: &str) -> Shape {
        let limits = Limits {
            publishers_max: T::PUBLISHERS_MAX,
            subscribers_max: T::SUBSCRIBERS_MAX,
            nodes_max: NODES_MAX,
            depth_max: T::DEPTH_MAX,
        };
        self.shape_of(T::NAME, TypeDetail::new::<Element<T>>(TypeVariant::Dynamic), name, limits)
    }

    /// The settings of a topic with these limits in the shipped pipeline.
    pub(crate) fn shape_of(
        &self,
        topic: &'static str,
        element: TypeDetail,
        name: &str,
        limits: Limits,
    ) -> Shape {
        let is_heartbeats = topic == HeartbeatsTopic::NAME;
        let interval = if is_heartbeats { HEARTBEAT } else { self.interval };
        Shape { topic, element, limits: self.limits(name, limits, is_heartbeats), interval }
    }

    /// Limits of a topic, by its name in shared memory. They count the ports of the shipped pipeline, of the
    /// stages that the pipeline file adds, and of spares. All processes of the run find the same limits in
    /// its record.
    fn limits(&self, name: &str, shipped: Limits, is_heartbeats: bool) -> Limits {
        if let Some(topic) = self.added.topic(name) {
            return self.with_spares_and_readers(name, self.added.limits(topic));
        }
        let heartbeat_count = if is_heartbeats { self.added.stage_count } else { 0 };
        self.with_spares_and_readers(
            name,
            Limits {
                publishers_max: shipped.publishers_max + heartbeat_count,
                subscribers_max: shipped.subscribers_max + self.added.reader_count(name),
                nodes_max: shipped.nodes_max + self.added.stage_count,
                ..shipped
            },
        )
    }
}

/// The topics of a run, created before any other process opens them, with places for all spares. They exist
/// as long as a process has them open.
#[derive(Debug)]
pub struct Topics {
    _services: Vec<Services<Head>>,
    _node: Node,
}

impl Topics {
    /// Creates the topics of a run.
    ///
    /// # Errors
    /// [`PortError`] if a topic can't be created.
    pub fn make(run: &Run) -> Result<Self, PortError> {
        let node = Node::open(run, "topics")?;
        let topics = TABLE.topics.iter().filter(|entry| entry.name != HeartbeatsTopic::NAME);
        let services = topics
            .map(|entry| Services::open(&node, entry.name, &node.raw_shape(&entry.into(), entry.name)?));
        let services = services.collect::<Result<_, _>>()?;
        Ok(Self { _services: services, _node: node })
    }
}
