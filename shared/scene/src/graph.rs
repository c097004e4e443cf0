//! The interaction graph: the neighbours of each agent at a step.

use wire::{AGENTS_MAX, AgentType, EDGES_MAX, Edge, HISTORY_MAX};

/// An agent that is present at a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position in the world frame.
    pub position_m: [f32; 2],
    /// The agent's type.
    pub agent_type: AgentType,
}

/// The rule that makes two agents neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeRule {
    /// Largest distance between neighbours, d.
    pub radius_m: f32,
    /// Largest distance if both agents are pedestrians.
    pub pedestrian_radius_m: f32,
    /// Maximum number of edges that an agent receives at a step, including its self edge. The nearest
    /// neighbours are kept.
    pub neighbours_max: usize,
}

/// Largest number of neighbours per agent with which every scene fits a frame: [`EDGES_MAX`] divided by the
/// numbers of agents and steps.
pub const NEIGHBOURS_MAX: usize = EDGES_MAX / (AGENTS_MAX * HISTORY_MAX);

impl EdgeRule {
    /// One radius for all pairs, and no limit on the number of neighbours, as in the paper.
    #[must_use]
    pub const fn within(radius_m: f32) -> Self {
        Self { radius_m, pedestrian_radius_m: radius_m, neighbours_max: usize::MAX }
    }

    /// Appends the edges of a step, sorted by (receiver, sender). Every present agent has its self edge;
    /// absent agents have no edges. Allocates only if `edges` lacks capacity.
    ///
    /// Costs n² distances: 128 agents take about 30 µs.
    ///
    /// # Panics
    /// If there are more than 65,536 agents.
    pub fn append(&self, step: u16, vertices: &[Option<Vertex>], edges: &mut Vec<Edge>) {
        let number = |agent: usize| u16::try_from(agent).expect("agents are numbered by 16 bits");
        let present = || vertices.iter().enumerate().filter_map(|(agent, v)| v.map(|v| (agent, v)));
        for (receiver, here) in present() {
            let start = edges.len();
            for (sender, there) in present() {
                if sender == receiver || self.joins(&here, &there) {
                    edges.push(Edge {
                        step,
                        receiver: number(receiver),
                        sender: number(sender),
                        reserved: 0,
                    });
                }
            }
            if edges.len() - start > self.neighbours_max {
                keep_nearest(&here, vertices, self.neighbours_max.max(1), start, edges);
            }
        }
    }

    fn joins(&self, a: &Vertex, b: &Vertex) -> bool {
        let pedestrians = a.agent_type == AgentType::Pedestrian && b.agent_type == AgentType::Pedestrian;
        let radius_m = if pedestrians { self.pedestrian_radius_m } else { self.radius_m };
        distance_squared(a, b) <= radius_m * radius_m
    }
}

fn distance_squared(a: &Vertex, b: &Vertex) -> f32 {
    let [dx, dy] = [0, 1].map(|axis| a.position_m[axis] - b.position_m[axis]);
    dx * dx + dy * dy
}

/// Keeps the `most` nearest edges from `start` on, ordered by sender. The self edge is among them.
fn keep_nearest(
    receiver: &Vertex,
    vertices: &[Option<Vertex>],
    most: usize,
    start: usize,
    edges: &mut Vec<Edge>,
) {
    let rank = |edge: &Edge| {
        let itself = edge.sender == edge.receiver;
        let sender = vertices[usize::from(edge.sender)].as_ref();
        let distance = sender.map_or(f32::INFINITY, |sender| distance_squared(receiver, sender));
        (!itself, distance, edge.sender)
    };
    let received = &mut edges[start..];
    received.select_nth_unstable_by(most - 1, |a, b| {
        let (a, b) = (rank(a), rank(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2))
    });
    received[..most].sort_unstable_by_key(|edge| edge.sender);
    edges.truncate(start + most);
}
