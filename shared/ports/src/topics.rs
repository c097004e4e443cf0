//! Opens the topics of a node.

use std::fmt::Debug;

use iceoryx2::service::static_config::message_type_details::{TypeDetail, TypeVariant};
use run::Run;
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic,
    HeartbeatsTopic, Topic, TracksTopic, TruthTopic,
};

use crate::element::Element;
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
        Shape {
            topic: T::NAME,
            element: TypeDetail::new::<Element<T>>(TypeVariant::Dynamic),
            limits: self.limits::<T>(name),
            interval: if T::NAME == HeartbeatsTopic::NAME { HEARTBEAT } else { self.interval },
        }
    }

    /// Limits of a topic, by its name in shared memory. They count the ports of the shipped pipeline, of the
    /// stages that the pipeline file adds, and of spares. All processes of the run find the same limits in
    /// its record.
    fn limits<T: Topic>(&self, name: &str) -> Limits {
        if let Some(topic) = self.added.topic(name) {
            return self.with_further(name, self.added.limits(topic));
        }
        let heartbeat_count = if T::NAME == HeartbeatsTopic::NAME { self.added.stage_count } else { 0 };
        self.with_further(
            name,
            Limits {
                publishers_max: T::PUBLISHERS_MAX + heartbeat_count,
                subscribers_max: T::SUBSCRIBERS_MAX + self.added.reader_count(name),
                nodes_max: NODES_MAX + self.added.stage_count,
                depth_max: T::DEPTH_MAX,
            },
        )
    }
}

/// The topics of a run, created before any other process opens them, with places for all spares. They exist
/// as long as a process has them open.
#[derive(Debug)]
pub struct Topics {
    _services: Vec<Box<dyn Debug>>,
    _node: Node,
}

impl Topics {
    /// Creates the topics of a run.
    ///
    /// # Errors
    /// [`PortError`] if a topic can't be created.
    pub fn make(run: &Run) -> Result<Self, PortError> {
        let node = Node::open(run, "topics")?;
        fn of<T: Topic>(node: &Node) -> Result<Box<dyn Debug>, PortError> {
            Ok(Box::new(Services::open(node, T::NAME, &node.shape::<T>(T::NAME))?))
        }
        let services = vec![
            of::<DetectionsTopic>(&node)?,
            of::<TracksTopic>(&node)?,
            of::<ContextTopic>(&node)?,
            of::<FeaturesTopic>(&node)?,
            of::<EncodingsTopic>(&node)?,
            of::<ControlsTopic>(&node)?,
            of::<ForecastsTopic>(&node)?,
            of::<TruthTopic>(&node)?,
        ];
        Ok(Self { _services: services, _node: node })
    }
}
