use nn::{ContextCnn, ContextMemory, Gdat, GdatMemory, Graph, GraphTrace, MlpMemory, RelationMlp, StateMlp};
use scene::{
    AgentFrame, ContextMap, EdgeRule, FeatureScales, MapBuilder, PatchOptions, State, Vertex, agent_frame,
    relation_features, state_features,
};
use wire::{
    CONTEXT_EMBEDDING, EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES, RELATION_FEATURES, STATE_EMBEDDING,
    STATE_FEATURES, TEMPORAL,
};

use super::folder::Folder;
use super::ledger::Ledger;
use crate::VerifyError;

/// The context map of the folder's points.
pub(super) fn map(folder: &Folder, ledger: &mut Ledger<'_>) -> Result<ContextMap, VerifyError> {
    let [rows, cols] = folder.scene.map_shape;
    let mut builder = MapBuilder::new(folder.scene.map_origin_m, rows, cols)
        .ok_or_else(|| folder.malformed(format!("a map of {rows} × {cols} cells is too large")))?;
    let points_m = folder.rows::<2>("map.points")?;
    for (position_m, velocity_mps) in points_m.into_iter().zip(folder.rows::<2>("map.velocities")?) {
        builder.visit(position_m, velocity_mps);
    }
    let map = builder.build();
    ledger.compare("map.density", &map.density().collect::<Vec<_>>())?;
    let axis = |axis: usize| map.velocity_mps().map(move |v| v[axis]);
    ledger.compare("map.velocity", &axis(0).chain(axis(1)).collect::<Vec<_>>())?;
    Ok(map)
}

/// The two graphs.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    History,
    Future,
}

/// The results of a graph that later stages need.
pub(super) struct Summary {
    /// State features s, \[step, agent\].
    pub(super) states: Vec<[f32; STATE_FEATURES]>,
    /// \[step, agent\].
    pub(super) present: Vec<bool>,
    /// ṽ of each agent.
    pub(super) temporal: Vec<[f32; TEMPORAL]>,
}

/// The layers from the scene to the temporal summary.
pub(super) struct Layers {
    state: StateMlp,
    relation: RelationMlp,
    context: ContextCnn,
    gdat: Gdat,
}

/// A graph's inputs: states \[step, agent\], the agents' frames, the number of steps.
struct Inputs {
    states: Vec<Option<State>>,
    frames: Vec<AgentFrame>,
    step_count: usize,
    agents_len: usize,
}

impl Inputs {
    fn of(folder: &Folder, part: Part) -> Result<Self, VerifyError> {
        let (history_len, agents_len) = (folder.config().history_len, folder.types.len());
        let frame = |agent: usize| {
            let history: Vec<_> = (0..history_len).map(|step| folder.state(step, agent)).collect();
            agent_frame(&history).ok_or_else(|| folder.malformed(format!("agent {agent} has no history")))
        };
        let steps = match part {
            Part::History => 0..history_len,
            Part::Future => history_len..history_len + folder.config().horizon_len,
        };
        Ok(Self {
            frames: (0..agents_len).map(frame).collect::<Result<_, _>>()?,
            step_count: steps.len(),
            states: steps
                .flat_map(|step| (0..agents_len).map(move |agent| folder.state(step, agent)))
                .collect(),
            agents_len,
        })
    }

    fn step(&self, step: usize) -> &[Option<State>] {
        &self.states[step * self.agents_len..][..self.agents_len]
    }

    /// A row for every pair of agents at every step, \[step, receiver, sender\].
    fn dense<const N: usize>(&self, edges: &[Edge], rows: &[[f32; N]]) -> Vec<[f32; N]> {
        let mut dense = vec![[0.0; N]; self.step_count * self.agents_len * self.agents_len];
        for (edge, row) in edges.iter().zip(rows) {
            dense[self.pair(edge)] = *row;
        }
        dense
    }

    fn pair(&self, edge: &Edge) -> usize {
        let [step, receiver, sender] = [edge.step, edge.receiver, edge.sender].map(usize::from);
        (step * self.agents_len + receiver) * self.agents_len + sender
    }

    fn edges(&self, folder: &Folder, rule: &EdgeRule) -> Vec<Edge> {
        let mut edges = Vec::new();
        for step in 0..self.step_count {
            let vertex = |(state, agent_type): (&Option<State>, _)| {
                state.map(|s| Vertex { position_m: s.position_m, agent_type })
            };
            let vertices: Vec<_> =
                self.step(step).iter().zip(folder.types.iter().copied()).map(vertex).collect();
            rule.append(step as u16, &vertices, &mut edges);
        }
        edges
    }
}

impl Layers {
    pub(super) fn new(folder: &Folder) -> Result<Self, VerifyError> {
        let wrong = |e| folder.weights_error(e);
        Ok(Self {
            state: StateMlp::new(&folder.weights).map_err(wrong)?,
            relation: RelationMlp::new(&folder.weights).map_err(wrong)?,
            context: ContextCnn::new(&folder.weights).map_err(wrong)?,
            gdat: Gdat::new(&folder.weights).map_err(wrong)?,
        })
    }

    /// Compares everything from the features of a graph to its temporal summaries.
    pub(super) fn run(
        &self,
        folder: &Folder,
        part: Part,
        map: &ContextMap,
        ledger: &mut Ledger<'_>,
    ) -> Result<Summary, VerifyError> {
        let name = |tensor: &str| match part {
            Part::History => format!("history.{tensor}"),
            Part::Future => format!("future.{tensor}"),
        };
        let config = folder.config();
        let scales = FeatureScales { position: config.position_scale, velocity: config.velocity_scale };
        let inputs = Inputs::of(folder, part)?;
        let present: Vec<bool> = inputs.states.iter().map(Option::is_some).collect();

        let features = |(row, state): (usize, &Option<State>)| {
            state.map_or([0.0; STATE_FEATURES], |s| {
                state_features(&inputs.frames[row % inputs.agents_len], &s, scales)
            })
        };
        let states: Vec<_> = inputs.states.iter().enumerate().map(features).collect();
        ledger.compare(&name("state"), states.as_flattened())?;
        let patches = self.patches(folder, &inputs, map);
        if part == Part::History {
            ledger.compare(&name("patches"), &patches)?;
        }
        let nodes = self.nodes(folder, &states, &present, &patches);
        ledger.compare(&name("node"), nodes.as_flattened())?;

        let everyone = inputs.edges(folder, &EdgeRule::within(f32::INFINITY));
        let (relations, attributes) = self.relations(&inputs, &everyone, scales);
        ledger.compare(&name("relation"), inputs.dense(&everyone, &relations).as_flattened())?;
        let attributes = inputs.dense(&everyone, &attributes);
        ledger.compare(&name("edge"), attributes.as_flattened())?;

        let edges = inputs.edges(folder, &EdgeRule::within(config.edge_radius_m));
        let ones = vec![[1.0]; edges.len()];
        ledger.compare(&name("adjacency"), inputs.dense(&edges, &ones).as_flattened())?;
        let attributes: Vec<_> = edges.iter().map(|edge| attributes[inputs.pair(edge)]).collect();
        let graph = Graph {
            agents_len: inputs.agents_len,
            present: &present,
            nodes: &nodes,
            edges: &edges,
            attributes: &attributes,
        };
        let mut temporal = vec![[0.0; TEMPORAL]; inputs.agents_len];
        let mut trace = GraphTrace::default();
        self.gdat.summarise_traced(&graph, &mut GdatMemory::default(), &mut temporal, &mut trace);
        compare_rounds(&inputs, &edges, &trace, config.topological_heads, &name, ledger)?;
        ledger.compare(&name("beta"), &trace.beta)?;
        ledger.compare(&name("temporal"), temporal.as_flattened())?;
        Ok(Summary { states, present, temporal })
    }

    fn patches(&self, folder: &Folder, inputs: &Inputs, map: &ContextMap) -> Vec<f32> {
        let options = PatchOptions {
            side: folder.config().patch_size,
            cell_m: folder.config().patch_cell_m,
            ahead_m: folder.config().patch_ahead_m,
        };
        let mut patches = vec![0.0; inputs.states.len() * options.len()];
        for (state, patch) in inputs.states.iter().zip(patches.chunks_exact_mut(options.len())) {
            if let Some(state) = state {
                map.patch(state, options, patch);
            }
        }
        patches
    }

    fn nodes(
        &self,
        folder: &Folder,
        states: &[[f32; STATE_FEATURES]],
        present: &[bool],
        patches: &[f32],
    ) -> Vec<[f32; NODE_ATTRIBUTES]> {
        let mut context = vec![[0.0; CONTEXT_EMBEDDING]; states.len()];
        self.context.embed(patches, &mut ContextMemory::default(), &mut context);
        let mut nodes = vec![[0.0; NODE_ATTRIBUTES]; states.len()];
        let mut memory = MlpMemory::default();
        for (row, node) in nodes.iter_mut().enumerate().filter(|(row, _)| present[*row]) {
            let agent_type = folder.types[row % folder.types.len()];
            let (state, rest) = node.split_at_mut(STATE_EMBEDDING);
            self.state.embed(agent_type, &states[row..=row], &mut memory, state);
            rest.copy_from_slice(&context[row]);
        }
        nodes
    }

    fn relations(
        &self,
        inputs: &Inputs,
        edges: &[Edge],
        scales: FeatureScales,
    ) -> (Vec<[f32; RELATION_FEATURES]>, Vec<[f32; EDGE_ATTRIBUTES]>) {
        let relation = |edge: &Edge| {
            let states = inputs.step(usize::from(edge.step));
            let [receiver, sender] = [edge.receiver, edge.sender].map(|agent| states[usize::from(agent)]);
            receiver.zip(sender).map_or([0.0; RELATION_FEATURES], |(i, j)| relation_features(&i, &j, scales))
        };
        let relations: Vec<_> = edges.iter().map(relation).collect();
        let mut attributes = vec![[0.0; EDGE_ATTRIBUTES]; edges.len()];
        self.relation.embed(&relations, &mut MlpMemory::default(), &mut attributes);
        (relations, attributes)
    }
}

fn compare_rounds(
    inputs: &Inputs,
    edges: &[Edge],
    trace: &GraphTrace,
    heads: usize,
    name: &impl Fn(&str) -> String,
    ledger: &mut Ledger<'_>,
) -> Result<(), VerifyError> {
    for (number, round) in trace.rounds.iter().enumerate() {
        // The folder stores α as [step, head, receiver, sender].
        let pairs = inputs.agents_len * inputs.agents_len;
        let mut alpha = vec![0.0; inputs.step_count * heads * pairs];
        for (edge, values) in edges.iter().zip(round.alpha.chunks_exact(heads)) {
            let (step, pair) = (inputs.pair(edge) / pairs, inputs.pair(edge) % pairs);
            for (head, value) in values.iter().enumerate() {
                alpha[(step * heads + head) * pairs + pair] = *value;
            }
        }
        ledger.compare(&name(&format!("topo{number}.alpha")), &alpha)?;
        ledger.compare(&name(&format!("topo{number}.node")), round.nodes.as_flattened())?;
        if !round.attributes.is_empty() {
            let dense = inputs.dense(edges, &round.attributes);
            ledger.compare(&name(&format!("topo{number}.edge")), dense.as_flattened())?;
        }
    }
    Ok(())
}
