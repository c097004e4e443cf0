//! Who is connected: the publishers and subscribers of others on the topics of the bridge.
//!
//! [`Graph`] knows every endpoint that DDS has discovered. Two endpoints match if topic and type are equal and the
//! publisher offers what the subscriber requests. If a topic of the bridge has no match, [`Graph::near_misses`]
//! names what is almost right:
//!
//! 1. the same topic with another type;
//! 2. the same topic and type, with a QoS that does not fit;
//! 3. the same type on another topic, as in another namespace;
//! 4. nobody in this domain, and sockets of another domain on this machine.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

/// The port of domain 0, and the number of ports of a domain.
const PORT: u16 = 7_400;
const PORTS_OF_DOMAIN: u16 = 250;
/// Largest domain whose ports are below those that Linux gives to other programs.
const DOMAIN_MAX: u16 = 101;
/// Maximum number of endpoints and nodes that are remembered.
const ENDPOINTS_MAX: usize = 4_096;
/// Maximum number of names in a list.
const NAMES_MAX: usize = 8;
/// The namespace of the bridge's own nodes.
const OWN: &str = "/stgdat/";

/// The identity of an endpoint: the GUID of DDS.
pub type Id = [u8; 16];

/// A publisher or a subscriber.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Name of the topic, as ROS writes it.
    pub topic: String,
    /// Type, such as `tf2_msgs/msg/TFMessage`.
    pub of_type: String,
    /// Whether it publishes.
    pub is_publisher: bool,
    /// Whether it offers or requests reliable messages.
    pub is_reliable: bool,
    /// Whether it offers or requests messages of the past (transient local).
    pub is_latched: bool,
}

impl Endpoint {
    /// An endpoint by the names of DDS; `None` if the topic is not one of ROS.
    #[must_use]
    pub fn of_dds(topic: &str, of_type: &str) -> Option<Self> {
        let topic = topic.strip_prefix("rt").filter(|name| name.starts_with('/'))?.to_owned();
        let of_type = of_type.replace("::dds_::", "::").replace("::", "/");
        let of_type = of_type.strip_suffix('_').unwrap_or(&of_type).to_owned();
        Some(Self { topic, of_type, is_publisher: false, is_reliable: false, is_latched: false })
    }

    fn verb(&self) -> &'static str {
        if self.is_publisher { "publishes" } else { "reads" }
    }

    fn short_type(&self) -> &str {
        self.of_type.rsplit('/').next().unwrap_or(&self.of_type)
    }

    /// Why this endpoint of the bridge and another one of the same topic and type do not fit; `None` if they do.
    fn misfit(&self, other: &Self) -> Option<&'static str> {
        let (publisher, reader) = if self.is_publisher { (self, other) } else { (other, self) };
        if reader.is_reliable && !publisher.is_reliable {
            return Some(match self.is_publisher {
                true => "it requests what the bridge does not offer",
                false => "its QoS is best effort: set best_effort = true in the options of the source",
            });
        }
        if reader.is_latched && !publisher.is_latched {
            return Some(match self.is_publisher {
                true => {
                    "it requests durability transient local, and the bridge offers volatile: set it to volatile there"
                }
                false => "its durability is volatile: a publisher of this topic must be transient local",
            });
        }
        None
    }
}

/// The endpoints of the bridge and of others.
#[derive(Debug, Default)]
pub struct Graph {
    own: Vec<Endpoint>,
    others: BTreeMap<Id, Endpoint>,
    /// Endpoints of others that DDS has refused for their QoS.
    refused: BTreeSet<Id>,
    /// The node of an endpoint.
    nodes: BTreeMap<Id, String>,
}

impl Graph {
    /// Adds an endpoint of the bridge.
    pub fn own(&mut self, endpoint: Endpoint) {
        self.own.push(endpoint);
    }

    /// Adds an endpoint of another participant.
    pub fn add(&mut self, id: Id, endpoint: Endpoint) {
        if self.others.len() < ENDPOINTS_MAX {
            self.others.insert(id, endpoint);
        }
    }

    /// States that DDS refuses the QoS of an endpoint.
    pub fn refuse(&mut self, id: Id) {
        if self.others.contains_key(&id) {
            self.refused.insert(id);
        }
    }

    /// Removes an endpoint.
    pub fn remove(&mut self, id: Id) {
        self.others.remove(&id);
        self.refused.remove(&id);
        self.nodes.remove(&id);
    }

    /// Removes all endpoints of a participant.
    pub fn remove_participant(&mut self, prefix: [u8; 12]) {
        self.others.retain(|id, _| id[..12] != prefix);
        self.refused.retain(|id| id[..12] != prefix);
        self.nodes.retain(|id, _| id[..12] != prefix);
    }

    /// States the node of an endpoint.
    pub fn name(&mut self, id: Id, node: &str) {
        if self.nodes.len() < ENDPOINTS_MAX {
            self.nodes.insert(id, node.to_owned());
        }
    }

    fn others_on<'a>(&'a self, own: &'a Endpoint) -> impl Iterator<Item = (&'a Id, &'a Endpoint)> {
        self.foreign().filter(|(_, other)| other.is_publisher != own.is_publisher && other.topic == own.topic)
    }

    /// The endpoints of others than the bridge's own nodes.
    fn foreign(&self) -> impl Iterator<Item = (&Id, &Endpoint)> {
        self.others.iter().filter(|(id, _)| !self.nodes.get(*id).is_some_and(|node| node.starts_with(OWN)))
    }

    fn is_match(&self, own: &Endpoint, (id, other): (&Id, &Endpoint)) -> bool {
        other.of_type == own.of_type && own.misfit(other).is_none() && !self.refused.contains(id)
    }

    fn matched<'a>(&'a self, own: &'a Endpoint) -> impl Iterator<Item = (&'a Id, &'a Endpoint)> {
        self.others_on(own).filter(|other| self.is_match(own, *other))
    }

    /// The node of an endpoint, or a word for it.
    fn node(&self, id: &Id, other: &Endpoint) -> String {
        let unnamed =
            || if other.is_publisher { "a publisher without a node" } else { "a reader without a node" };
        self.nodes.get(id).cloned().unwrap_or_else(|| unnamed().to_owned())
    }

    /// The matched endpoints of each topic, such as `reads /tf from /localizer`.
    #[must_use]
    pub fn connections(&self) -> Vec<(String, String)> {
        let each = self.own.iter().map(|own| {
            let mut counts: BTreeMap<String, usize> = BTreeMap::new();
            self.matched(own).for_each(|(id, other)| *counts.entry(self.node(id, other)).or_default() += 1);
            let mut names = String::new();
            for (place, (node, count)) in counts.iter().take(NAMES_MAX).enumerate() {
                // A `String` takes every text.
                let _ = write!(names, "{}{node}", if place > 0 { ", " } else { "" });
                let _ = if *count > 1 { write!(names, " ({count} times)") } else { Ok(()) };
            }
            match counts.len() {
                0 => names.push_str("nobody"),
                len if len > NAMES_MAX => drop(write!(names, " and {} more", len - NAMES_MAX)),
                _ => {}
            }
            let way = if own.is_publisher { "to" } else { "from" };
            (format!("{} {} {way}", own.verb(), own.topic), names)
        });
        each.collect()
    }

    /// Whether this endpoint of the bridge is matched.
    #[must_use]
    pub fn is_matched(&self, topic: &str) -> bool {
        self.own.iter().any(|own| own.topic == topic && self.matched(own).next().is_some())
    }

    /// What is almost right for each topic without a match. `needed` are topics that must have one; `domain` and
    /// `place` are the bridge's domain and interfaces, and `domains` others whose sockets are on this machine.
    #[must_use]
    pub fn near_misses(&self, needed: &[String], domain: u16, place: &str, domains: &[u16]) -> Vec<String> {
        let mut lines = Vec::new();
        for own in self.own.iter().filter(|own| self.matched(own).next().is_none()) {
            let topic = &own.topic;
            let before = lines.len();
            for (id, other) in self.others_on(own) {
                let node = self.node(id, other);
                if other.of_type != own.of_type {
                    let option = match (own.is_publisher, other.short_type()) {
                        (false, "TrackedObjects") => {
                            format!(": set tracks = [\"{topic}\"] in the options of the source")
                        }
                        (false, "DetectedObjects") => {
                            format!(": set detections = [\"{topic}\"] in the options of the source")
                        }
                        _ => String::new(),
                    };
                    let (of, own_type) = (&other.of_type, &own.of_type);
                    lines.push(format!("{node} {} {topic} as {of}, not as {own_type}{option}", other.verb()));
                } else {
                    let why = own.misfit(other).unwrap_or("DDS refuses its QoS");
                    lines.push(format!("{node} {} {topic}, but {why}", other.verb()));
                }
            }
            let elsewhere = self.foreign().filter(|(_, other)| {
                let is_own = self.own.iter().any(|own| own.topic == other.topic);
                other.is_publisher != own.is_publisher && other.of_type == own.of_type && !is_own
            });
            for (id, other) in elsewhere.take(NAMES_MAX) {
                let (node, there, of) = (self.node(id, other), &other.topic, own.short_type());
                lines.push(format!(
                    "{node} {} {of} on {there}, not on {topic}: set remap = [\"{topic}:={there}\"]",
                    other.verb()
                ));
            }
            if lines.len() == before && needed.contains(topic) {
                let of = own.short_type();
                let mut line = format!("nobody publishes {topic} ({of}) in domain {domain} on {place}");
                match (self.others.is_empty(), domains) {
                    (true, []) => line.push_str(
                        ": name the interface of the publisher in `interfaces`, and check the multicast of the \
                         loopback interface",
                    ),
                    (_, []) => {}
                    (_, domains) => {
                        let names: Vec<String> = domains.iter().map(u16::to_string).collect();
                        let (all, first) = (names.join(", "), &domains[0]);
                        let _ = write!(
                            line,
                            ": programs of this machine are in domain {all}: set domain = {first} or ROS_DOMAIN_ID"
                        );
                    }
                }
                lines.push(line);
            }
        }
        lines
    }
}

/// The domains whose ports are open on this machine, from the text of `/proc/net/udp`, without `own`.
#[must_use]
pub fn domains(sockets: &str, own: u16) -> Vec<u16> {
    let port = |line: &str| {
        let local = line.split_whitespace().nth(1)?.rsplit(':').next()?;
        u16::from_str_radix(local, 16).ok()
    };
    let ports = sockets.lines().filter_map(port).filter_map(|port| port.checked_sub(PORT));
    // Multicast of discovery and messages, then the first participants. Other programs have the other ports.
    let ports = ports.filter(|port| matches!(port % PORTS_OF_DOMAIN, 0 | 1 | 10..40));
    let found: BTreeSet<u16> = ports.map(|port| port / PORTS_OF_DOMAIN).collect();
    found.into_iter().filter(|domain| *domain <= DOMAIN_MAX && *domain != own).collect()
}

#[cfg(test)]
mod tests;
