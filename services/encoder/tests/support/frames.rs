//! Features of agents with edges between all pairs.

use bytemuck::Zeroable;
use testing::value;
use wire::{AgentEncoding, AgentFeatures, Edge, Features, Header};

/// Steps of the history.
const HISTORY_LEN: usize = 8;

pub struct Frame {
    pub header: Header,
    pub agents: Vec<AgentFeatures>,
    pub edges: Vec<Edge>,
    pub attributes: Vec<[f32; 16]>,
}

impl Frame {
    pub fn new(agents_len: usize) -> Self {
        let mut header = Header::new(1, 0, 0);
        header.counts.agents_len = agents_len as u32;
        header.counts.history_len = HISTORY_LEN as u32;
        let agent = |i: usize| {
            let mut agent = AgentFeatures {
                id: i as u64,
                agent_type: (i % 3) as u32,
                present: 0xff,
                forecastable: 1,
                ..AgentFeatures::zeroed()
            };
            for (k, x) in agent.node.as_flattened_mut().iter_mut().enumerate() {
                *x = value(i * 512 + k);
            }
            agent
        };
        let agents: Vec<_> = (0..agents_len).map(agent).collect();
        let place = |i: usize| Edge {
            step: (i / (agents_len * agents_len)) as u16,
            receiver: (i / agents_len % agents_len) as u16,
            sender: (i % agents_len) as u16,
            reserved: 0,
        };
        let edges: Vec<_> = (0..HISTORY_LEN * agents_len * agents_len).map(place).collect();
        let attributes = (0..edges.len()).map(|i| std::array::from_fn(|k| value(i * 16 + k + 5))).collect();
        Self { header, agents, edges, attributes }
    }

    pub fn features(&self) -> Features<'_> {
        Features { agents: &self.agents, edges: &self.edges, attributes: &self.attributes }
    }

    /// Zeroed encodings, one for each agent.
    pub fn out(&self) -> Vec<AgentEncoding> {
        vec![AgentEncoding::zeroed(); self.agents.len()]
    }
}
