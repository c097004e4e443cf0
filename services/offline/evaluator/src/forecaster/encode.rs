//! From a scene to the temporal summary of each agent: features, graph, embeddings, attention.

use nn::Graph;
use scene::{Vertex, agent_frame, relation_features, state_features};
use wire::{
    CONTEXT_EMBEDDING, EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES, RELATION_FEATURES, STATE_FEATURES, TEMPORAL,
};

use super::{Forecaster, ForecasterMemory};
use crate::Scene;

/// A scene as the encoder sees it.
#[derive(Default)]
pub(super) struct Encoding {
    agents_len: usize,
    /// State features, \[step, agent\], zeros where absent.
    states: Vec<[f32; STATE_FEATURES]>,
    present: Vec<bool>,
    nodes: Vec<[f32; NODE_ATTRIBUTES]>,
    edges: Vec<Edge>,
    relations: Vec<[f32; RELATION_FEATURES]>,
    attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// Rows of one type with their features and embeddings.
    rows: Vec<usize>,
    features: Vec<[f32; STATE_FEATURES]>,
    embedded: Vec<f32>,
    /// Summaries ṽ, one per agent.
    pub(super) temporal: Vec<[f32; TEMPORAL]>,
}

impl Encoding {
    /// State features of an agent at a step, where it is present.
    pub(super) fn state(&self, step: usize, agent: usize) -> Option<[f32; STATE_FEATURES]> {
        let row = step * self.agents_len + agent;
        self.present[row].then(|| self.states[row])
    }
}

impl Forecaster {
    /// Fills `memory.encoding`.
    pub(super) fn encode(
        &self,
        scene: &Scene,
        context: impl Fn(usize, usize) -> [f32; CONTEXT_EMBEDDING],
        memory: &mut ForecasterMemory,
    ) {
        let agents_len = scene.agents.len();
        self.describe(scene, &mut memory.encoding);
        self.embed_states(scene, memory);
        let Encoding { nodes, present, edges, relations, attributes, temporal, .. } = &mut memory.encoding;
        if self.config.context {
            for (row, node) in nodes.iter_mut().enumerate().filter(|(row, _)| present[*row]) {
                let half = node.len() - CONTEXT_EMBEDDING;
                node[half..].copy_from_slice(&context(row % agents_len, row / agents_len));
            }
        }
        attributes.resize(edges.len(), [0.0; EDGE_ATTRIBUTES]);
        self.relation_mlp.embed(relations, &mut memory.mlp, attributes);
        temporal.resize(agents_len, [0.0; TEMPORAL]);
        let graph = Graph { agents_len, present, nodes, edges, attributes };
        self.gdat.summarise(&graph, &mut memory.gdat, temporal);
    }

    /// State features, edges and relation features of all steps.
    fn describe(&self, scene: &Scene, encoding: &mut Encoding) {
        let Encoding { agents_len, states, present, nodes, edges, relations, .. } = encoding;
        *agents_len = scene.agents.len();
        let frames: Vec<_> = scene.agents.iter().map(|agent| agent_frame(&agent.history)).collect();
        states.clear();
        present.clear();
        edges.clear();
        for step in 0..self.config.history_len {
            for (agent, frame) in scene.agents.iter().zip(&frames) {
                let state = agent.history[step].zip(frame.as_ref());
                present.push(state.is_some());
                states.push(state.map_or([0.0; STATE_FEATURES], |(state, frame)| {
                    state_features(frame, &state, self.scales)
                }));
            }
            let vertex = |agent: &crate::Agent| {
                let position_m = agent.history[step]?.position_m;
                Some(Vertex { position_m, agent_type: agent.agent_type })
            };
            let vertices: Vec<_> = scene.agents.iter().map(vertex).collect();
            self.rule.append(step as u16, &vertices, edges);
        }
        nodes.clear();
        nodes.resize(states.len(), [0.0; NODE_ATTRIBUTES]);
        relations.clear();
        relations.extend(edges.iter().map(|edge| {
            let state = |agent: u16| {
                scene.agents[usize::from(agent)].history[usize::from(edge.step)].unwrap_or_default()
            };
            relation_features(&state(edge.receiver), &state(edge.sender), self.scales)
        }));
    }

    /// State embeddings of all present nodes, one network after the other.
    fn embed_states(&self, scene: &Scene, memory: &mut ForecasterMemory) {
        let Encoding { agents_len, states, present, nodes, rows, features, embedded, .. } =
            &mut memory.encoding;
        let len = self.config.state_embedding_len();
        for of_type in wire::AGENT_TYPES {
            let wanted =
                |row: &usize| present[*row] && scene.agents[*row % *agents_len].agent_type == of_type;
            rows.clear();
            rows.extend((0..states.len()).filter(wanted));
            features.clear();
            features.extend(rows.iter().map(|&row| states[row]));
            embedded.resize(rows.len() * len, 0.0);
            self.state_mlp.embed(of_type, features, &mut memory.mlp, embedded);
            for (&row, embedding) in rows.iter().zip(embedded.chunks_exact(len)) {
                nodes[row][..len].copy_from_slice(embedding);
            }
        }
    }
}
