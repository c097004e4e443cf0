//! The node in ROS 2: publishers and subscriptions with the QoS of Autoware.

use std::net::{IpAddr, UdpSocket};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use futures::executor::block_on;
use interop::Definition;
use interop::messages::Clock;
use ports::StageError;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, CreateError, MessageTypeName, Name, NodeName, NodeOptions, Publisher, QosProfile, Subscription,
    WriteError,
};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent, EndpointDescription,
    RTPSEntity as _, StatusEvented as _, policy,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::diagnostics::Link;
use crate::graph::{self, Endpoint, Graph};
use crate::options::{Options, UnknownDomain, names};
use crate::ticks::time_ns;

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

/// The topic on which the participants of ROS name their nodes.
const NODES: &str = "ros_discovery_info";
/// Time between two looks at the events of discovery.
const LOOK: Duration = Duration::from_millis(200);
/// Time without a change after which the connections are logged, so that a start is one line.
const SETTLED: Duration = Duration::from_secs(1);
/// Time without a match after which near misses are logged.
const UNMATCHED: Duration = Duration::from_secs(5);

/// The node of the bridge.
pub struct Node {
    node: ros2_client::Node,
    connections: Connections,
    simulated_ns: Option<Arc<AtomicI64>>,
    // Entities live as long as the context.
    _context: Context,
}

/// The connections of a node, for its diagnostics.
#[derive(Clone, Debug, Default)]
pub struct Connections(Arc<Mutex<Known>>);

#[derive(Debug, Default)]
struct Known {
    graph: Graph,
    /// Topics that must have a publisher.
    needed: Vec<String>,
    near_misses: Vec<String>,
}

/// The nodes of a participant of ROS, since Iron.
#[derive(Debug, Deserialize)]
struct ParticipantNodes {
    #[expect(dead_code, reason = "a field of the message")]
    participant: graph::Id,
    nodes: Vec<NodeEndpoints>,
}

#[derive(Debug, Deserialize)]
struct NodeEndpoints {
    namespace: String,
    name: String,
    readers: Vec<graph::Id>,
    writers: Vec<graph::Id>,
}

impl Connections {
    fn known(&self) -> MutexGuard<'_, Known> {
        // A panic leaves a graph that lacks an endpoint at most.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The connections now. Near misses are those of topics that have had no match for five seconds.
    #[must_use]
    pub fn link(&self) -> Link {
        let known = self.known();
        Link { connections: known.graph.connections(), near_misses: known.near_misses.clone() }
    }
}

/// Follows discovery: logs the connections when they change, and near misses.
struct Watch {
    known: Weak<Mutex<Known>>,
    participant: DomainParticipant,
    nodes: Option<Subscription<ParticipantNodes>>,
    domain: u16,
    interfaces: String,
}

impl Watch {
    fn run(self) {
        let listener = self.participant.status_listener();
        let own = self.participant.guid().to_bytes();
        let (mut logged, mut changed, mut seen) = (Vec::new(), Instant::now(), Vec::new());
        let begun = Instant::now();
        // The thread ends with the node.
        while let Some(known) = self.known.upgrade() {
            let connections = Connections(known);
            {
                let graph = &mut connections.known().graph;
                while let Some(event) = listener.try_recv_status() {
                    take(graph, event, &own);
                }
                while let Some(nodes) = self.nodes.as_ref().and_then(|nodes| nodes.take().ok().flatten()) {
                    name(graph, &nodes.0);
                }
            }
            let now = connections.link().connections;
            if now != seen {
                (changed, seen) = (Instant::now(), now);
            }
            if changed.elapsed() >= SETTLED && seen != logged {
                let lines: Vec<String> =
                    seen.iter().map(|(topic, names)| format!("{topic} {names}")).collect();
                let lines = lines.join("; ");
                tracing::info!(target: ports::OUTPUT_TARGET, "connections: {}", ports::escaped(&lines, false));
                logged.clone_from(&seen);
            }
            if changed.elapsed().min(begun.elapsed()) >= UNMATCHED {
                self.look_for_near_misses(&connections);
            }
            drop(connections);
            std::thread::sleep(LOOK);
        }
    }

    fn look_for_near_misses(&self, connections: &Connections) {
        let sockets = ["/proc/net/udp", "/proc/net/udp6"].map(|path| std::fs::read_to_string(path).ok());
        let sockets: String = sockets.into_iter().flatten().collect();
        let domains = graph::domains(&sockets, self.domain);
        let mut known = connections.known();
        let found = known.graph.near_misses(&known.needed, self.domain, &self.interfaces, &domains);
        for line in found.iter().filter(|line| !known.near_misses.contains(line)) {
            tracing::warn!("{}", ports::escaped(line, false));
        }
        known.near_misses = found;
    }
}

/// Takes an event of discovery.
fn take(graph: &mut Graph, event: DomainParticipantStatusEvent, own: &graph::Id) {
    use DomainParticipantStatusEvent as Event;
    match event {
        Event::ReaderDetected { reader } => add(graph, &reader, false, own),
        Event::WriterDetected { writer } => add(graph, &writer, true, own),
        Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => graph.remove(guid.to_bytes()),
        Event::RemoteReaderQosIncompatible { remote_reader: other, .. }
        | Event::RemoteWriterQosIncompatible { remote_writer: other, .. } => graph.refuse(other.to_bytes()),
        Event::ParticipantLost { id, .. } => {
            let mut prefix = [0; 12];
            prefix.copy_from_slice(id.as_ref());
            graph.remove_participant(prefix);
        }
        _ => {}
    }
}

fn add(graph: &mut Graph, of: &EndpointDescription, is_publisher: bool, own: &graph::Id) {
    let id = of.guid.to_bytes();
    if id[..12] == own[..12] {
        return;
    }
    if let Some(endpoint) = Endpoint::of_dds(&of.topic_name, &of.type_name) {
        // Cyclone leaves out the defaults of DDS.
        let is_reliable = of
            .qos
            .reliability()
            .map_or(is_publisher, |of| matches!(of, policy::Reliability::Reliable { .. }));
        let is_latched = of.qos.durability().is_some_and(|of| of >= policy::Durability::TransientLocal);
        graph.add(id, Endpoint { is_publisher, is_reliable, is_latched, ..endpoint });
    }
}

fn name(graph: &mut Graph, of: &ParticipantNodes) {
    for NodeEndpoints { namespace, name, readers, writers } in &of.nodes {
        let node = format!("{}/{name}", namespace.trim_end_matches('/'));
        readers.iter().chain(writers).for_each(|id| graph.name(*id, &node));
    }
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
        let context =
            Context::from_domain_participant(participant.clone()).map_err(dds("the participant"))?;
        let named = NodeName::new("/stgdat", name)
            .map_err(|why| NodeError::Dds { what: format!("the node {name}"), why: format!("{why:?}") })?;
        let mut node = context
            .new_node(named, NodeOptions::new().start_parameter_services(false))
            .map_err(|why| NodeError::Dds { what: format!("the node {name}"), why: format!("{why:?}") })?;
        let interfaces: Vec<String> = options.interfaces.iter().map(ToString::to_string).collect();
        let interfaces = interfaces.join(", ");
        tracing::info!("node /stgdat/{name} in DDS domain {domain} on {interfaces}");
        let connections = Connections::default();
        let latched = latched(1);
        let nodes = context.create_topic(
            NODES.to_owned(),
            MessageTypeName::new("rmw_dds_common", "ParticipantEntitiesInfo"),
            &latched,
        );
        // Without the names of nodes, endpoints are counted.
        let nodes = nodes.and_then(|topic| node.create_subscription(&topic, None)).ok();
        let known = Arc::downgrade(&connections.0);
        let watch = Watch { known, participant, nodes, domain, interfaces };
        std::thread::Builder::new().name("ros2-graph".to_owned()).spawn(move || watch.run())?;
        let mut opened = Self { node, connections, simulated_ns: None, _context: context };
        if options.use_sim_time {
            let simulated_ns = Arc::new(AtomicI64::new(0));
            opened.simulated_ns = Some(Arc::clone(&simulated_ns));
            let qos = reliable(1).reliability_best_effort();
            let take = move |Clock { clock }: Clock| {
                simulated_ns.store(time_ns(&clock), Ordering::Relaxed);
                true
            };
            opened.read(options.topic(names::CLOCK), &Clock::DEFINITION, &qos, take)?;
        }
        Ok(opened)
    }

    /// The time of `/clock`, if the time is simulated.
    #[must_use]
    pub fn simulated_ns(&self) -> Option<i64> {
        self.simulated_ns.as_ref().map(|ns| ns.load(Ordering::Relaxed))
    }

    /// The connections of this node.
    #[must_use]
    pub fn connections(&self) -> Connections {
        self.connections.clone()
    }

    /// States that a topic must have a publisher.
    pub fn need(&self, topic: &str) {
        self.connections.known().needed.push(topic.to_owned());
    }

    /// Adds an endpoint to the graph.
    fn own(&self, name: &str, definition: &Definition, qos: &QosProfile, is_publisher: bool) {
        let qos: rustdds::QosPolicies = qos.into();
        let endpoint = Endpoint {
            topic: name.to_owned(),
            of_type: definition.name.to_owned(),
            is_publisher,
            is_reliable: matches!(qos.reliability(), Some(policy::Reliability::Reliable { .. })),
            is_latched: qos.durability().is_some_and(|of| of >= policy::Durability::TransientLocal),
        };
        self.connections.known().graph.own(endpoint);
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
        self.own(name, definition, qos, true);
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
        self.own(name, definition, qos, false);
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
    /// Publishes a message, or counts it as dropped if DDS has no room. Does not wait. Returns whether DDS has taken it.
    pub fn publish(&mut self, message: M) -> bool {
        match self.publisher.publish(message) {
            Ok(()) => {
                self.sent += 1;
                return true;
            }
            Err(WriteError::WouldBlock { .. }) => self.dropped += 1,
            Err(error) => {
                self.dropped += 1;
                tracing::warn!("a message can't be published: {error}");
            }
        }
        false
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
