//! The node in ROS 2: publishers and subscriptions with the QoS of Autoware.

use std::net::{IpAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt as _;
use futures::executor::block_on;
use interop::Definition;
use ports::StageError;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, CreateError, MessageTypeName, Name, NodeName, NodeOptions, Publisher, QosProfile, WriteError,
};
use rustdds::DomainParticipantBuilder;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::options::{Options, UnknownDomain};

/// The receiving and sending buffers of a socket. A kernel with smaller limits clamps them.
const BUFFER_BYTES: usize = 8 << 20;

/// Why the node can't be used.
#[derive(Debug, Error)]
pub enum NodeError {
    /// The environment names no domain.
    #[error(transparent)]
    Domain(#[from] UnknownDomain),
    /// No interface of this machine has the address.
    #[error("interfaces: {address}: {why}")]
    Interface {
        /// The address.
        address: IpAddr,
        /// The system's error.
        why: std::io::Error,
    },
    /// DDS refuses the participant, the node or a topic.
    #[error("{what}: {why}")]
    Dds {
        /// What is refused.
        what: String,
        /// The reason.
        why: String,
    },
    /// A thread can't be started.
    #[error("a thread can't be started: {0}")]
    Thread(#[from] std::io::Error),
}

impl From<NodeError> for StageError {
    fn from(error: NodeError) -> Self {
        match error {
            NodeError::Domain(_) => Self::config(error),
            // An interface may come up later: the stage is started again.
            NodeError::Interface { .. } | NodeError::Dds { .. } | NodeError::Thread(_) => Self::data(error),
        }
    }
}

fn dds(what: impl Into<String>) -> impl FnOnce(CreateError) -> NodeError {
    let what = what.into();
    |why| NodeError::Dds { what, why: why.to_string() }
}

/// Reliable and volatile, with a queue of `depth`. A writer never waits for a slow reader.
#[must_use]
pub const fn reliable(depth: usize) -> QosProfile {
    QosProfile::publisher_default().reliability_reliable(WhenFull::Fail).history(History::KeepLast { depth })
}

/// The same for a topic whose last messages a new reader receives.
#[must_use]
pub const fn latched(depth: usize) -> QosProfile {
    reliable(depth).durability(Durability::TransientLocal)
}

/// The node of the bridge.
pub struct Node {
    node: ros2_client::Node,
    // Entities live as long as the context.
    _context: Context,
}

/// A publisher of one type of message.
pub struct Writer<M: Serialize> {
    publisher: Publisher<M>,
    /// Messages that DDS did not take.
    dropped: u64,
    /// Messages that DDS has taken.
    sent: u64,
}

impl Node {
    /// Joins the domain on the named interfaces alone.
    ///
    /// # Errors
    /// [`NodeError`] if the domain is unknown or DDS can't be started.
    pub fn open(options: &Options, name: &str) -> Result<Self, NodeError> {
        let domain = options.domain()?;
        for &address in &options.interfaces {
            // DDS would be silent.
            UdpSocket::bind((address, 0)).map_err(|why| NodeError::Interface { address, why })?;
        }
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks(options.interfaces.iter().copied())
            .socket_receive_buffer_size(BUFFER_BYTES)
            .socket_send_buffer_size(BUFFER_BYTES)
            .build()
            .map_err(|why| NodeError::Dds { what: format!("domain {domain}"), why: why.to_string() })?;
        let context = Context::from_domain_participant(participant).map_err(dds("the participant"))?;
        let named = NodeName::new("/stgdat", name)
            .map_err(|why| NodeError::Dds { what: format!("the node {name}"), why: format!("{why:?}") })?;
        let node = context
            .new_node(named, NodeOptions::new().start_parameter_services(false))
            .map_err(|why| NodeError::Dds { what: format!("the node {name}"), why: format!("{why:?}") })?;
        let interfaces: Vec<String> = options.interfaces.iter().map(ToString::to_string).collect();
        tracing::info!("node /stgdat/{name} in DDS domain {domain} on {}", interfaces.join(", "));
        Ok(Self { node, _context: context })
    }

    fn topic(
        &self,
        name: &str,
        definition: &Definition,
        qos: &QosProfile,
    ) -> Result<rustdds::Topic, NodeError> {
        let (package, of) = definition.name.split_once("/msg/").unwrap_or(("", definition.name));
        let refused = |why: String| NodeError::Dds { what: format!("the topic {name}"), why };
        let parsed = Name::parse(name).map_err(|why| refused(format!("{why:?}")))?;
        self.node
            .create_topic(&parsed, MessageTypeName::new(package, of), qos)
            .map_err(|why| refused(why.to_string()))
    }

    /// Opens a publisher.
    ///
    /// # Errors
    /// [`NodeError`] if DDS refuses the topic.
    pub fn writer<M: Serialize>(
        &mut self,
        name: &str,
        definition: &Definition,
        qos: &QosProfile,
    ) -> Result<Writer<M>, NodeError> {
        let topic = self.topic(name, definition, qos)?;
        let publisher = self.node.create_publisher(&topic, None).map_err(dds(name))?;
        Ok(Writer { publisher, dropped: 0, sent: 0 })
    }

    /// Opens a subscription, whose messages a thread passes on until `take` returns `false`.
    ///
    /// # Errors
    /// [`NodeError`] if DDS refuses the topic.
    pub fn read<M: DeserializeOwned + Send + 'static>(
        &mut self,
        name: &str,
        definition: &Definition,
        qos: &QosProfile,
        mut take: impl FnMut(M) -> bool + Send + 'static,
    ) -> Result<(), NodeError> {
        let topic = self.topic(name, definition, qos)?;
        let subscription = self.node.create_subscription::<M>(&topic, None).map_err(dds(name))?;
        let name: Arc<str> = name.into();
        let thread = std::thread::Builder::new().name("ros2-reader".to_owned());
        thread.spawn(move || {
            block_on(async {
                let mut messages = std::pin::pin!(subscription.async_stream());
                while let Some(message) = messages.next().await {
                    match message {
                        Ok((message, _)) => {
                            if !take(message) {
                                return;
                            }
                        }
                        Err(error) => tracing::warn!("{name}: a message can't be read: {error}"),
                    }
                }
            });
        })?;
        Ok(())
    }
}

impl<M: Serialize> Writer<M> {
    /// Publishes a message, or counts it as dropped if DDS has no room. Does not wait.
    pub fn publish(&mut self, message: M) {
        match self.publisher.publish(message) {
            Ok(()) => self.sent += 1,
            Err(WriteError::WouldBlock { .. }) => self.dropped += 1,
            Err(error) => {
                self.dropped += 1;
                tracing::warn!("a message can't be published: {error}");
            }
        }
    }

    /// Messages that DDS has taken, and those that it had no room for.
    #[must_use]
    pub const fn counts(&self) -> [u64; 2] {
        [self.sent, self.dropped]
    }
}

/// Time that DDS has to send the end of its writers.
pub const FAREWELL: Duration = Duration::from_millis(50);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_of_another_machine_is_refused() {
        let interfaces = vec!["192.0.2.1".parse().expect("an address for documents")];
        let options = Options { interfaces, ..Options::default() };
        let error = Node::open(&options, "test").err().expect("an error").to_string();
        assert!(error.starts_with("interfaces: 192.0.2.1: "), "{error}");
    }
}
