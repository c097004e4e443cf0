//! Node and edge attributes of the history graph, from tracks and their context patches.
//!
//! A node is an agent at a history step. Its attribute v = \[SE ‖ CE\] consists of the state embedding and
//! the context embedding. An edge joins two agents that are near each other at a step. Its attribute e is the
//! relation embedding.
//!
//! SE is relative to the agent's newest state and is computed in each tick. CE and e depend only on the
//! states of their own step. So CE is cached by (track, stamp) and e by (pair, stamp). In a steady run, CE and e
//! are computed for the newest step only. After a restart, the window refills the cache. The tracker smooths
//! older states of noisy detections. CE and e then belong to the state as it was published.

mod cache;
mod embed;
mod options;
mod queue;
mod step;

pub use nn::StartError;
use nn::{AgentSet, ModelConfig, Weights, WeightsError, Workers, with_senders};
pub use options::{Options, STAGE};
use scene::{AgentFrame, EdgeRule, FeatureScales, NEIGHBOURS_MAX, State, Vertex};
pub use step::{run, settings};
use wire::{
    AGENT_TYPES, AGENTS_MAX, AgentFeatures, AgentType, CONTEXT_EMBEDDING, Context, ContextShape,
    EDGE_ATTRIBUTES, EDGES_MAX, Edge, FeatureShape, FeaturesMut, HISTORY_MAX, Header, NODE_ATTRIBUTES,
    Rejected, equal, finite,
};

use cache::StampCache;
use embed::{Embedder, Embedding, Wanted};
use queue::Queue;

/// Settings of an [`Extractor`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExtractorOptions {
    /// Number of threads that run the networks, including the stage's own thread. Results do not depend on
    /// it.
    pub workers: usize,
}

/// Work done for a frame because of cache misses, and edges that were left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Patches that went through the CNN.
    pub patch_count: usize,
    /// Pairs that went through the relation MLP.
    pub relation_count: usize,
    /// Edges to the farthest neighbours, left out because the frame was full.
    pub edges_dropped: usize,
}

/// The extractor: its networks, its cache and the current frame.
pub struct Extractor {
    config: ModelConfig,
    rule: EdgeRule,
    scales: FeatureScales,
    embedders: Workers<Embedder>,
    cache: StampCache,
    queue: Queue,
    /// Run, number and stamp of the newest tick.
    last: Option<(u64, (u64, i64))>,
    frame: Frame,
    effort: Effort,
}

/// The current frame.
#[derive(Default)]
struct Frame {
    agents: Vec<AgentFeatures>,
    edges: Vec<Edge>,
    attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// States, \[agent, step\].
    states: Vec<[Option<State>; HISTORY_MAX]>,
    vertices: Vec<Option<Vertex>>,
    /// The agents whose nodes are needed, by step; empty if all are needed.
    needed: Vec<AgentSet>,
    wanted: Wanted,
}

impl Frame {
    /// A frame with memory for the largest scene.
    fn with_room() -> Self {
        Self {
            agents: Vec::with_capacity(AGENTS_MAX),
            edges: Vec::with_capacity(EDGES_MAX),
            attributes: Vec::with_capacity(EDGES_MAX),
            states: Vec::with_capacity(AGENTS_MAX),
            vertices: Vec::with_capacity(AGENTS_MAX),
            needed: Vec::with_capacity(HISTORY_MAX),
            wanted: Wanted::default(),
        }
    }

    fn clear(&mut self) {
        self.agents.clear();
        self.edges.clear();
        self.attributes.clear();
    }
}

impl Extractor {
    /// An extractor with an empty cache.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not hold the model or a thread can't be started.
    pub fn new(weights: &Weights, options: ExtractorOptions) -> Result<Self, StartError> {
        let config = weights.config().clone();
        config.check_frames().map_err(WeightsError::from)?;
        let rule = EdgeRule {
            radius_m: config.edge_radius_m,
            pedestrian_radius_m: config.pedestrian_edge_radius_m.unwrap_or(config.edge_radius_m),
            neighbours_max: usize::MAX,
        };
        Ok(Self {
            rule,
            scales: FeatureScales { position: config.position_scale, velocity: config.velocity_scale },
            embedders: Embedder::pool(weights, options.workers.max(1))?,
            cache: StampCache::default(),
            queue: Queue::new(),
            last: None,
            frame: Frame::with_room(),
            effort: Effort::default(),
            config,
        })
    }

    /// The work that was done for the last frame.
    pub const fn effort(&self) -> Effort {
        self.effort
    }

    /// Computes the features of a frame and returns their shape. [`Extractor::write`] writes them. A control
    /// frame has no features.
    ///
    /// With a limit, each forecastable agent gets a turn. The first `served_max` agents are served, and the
    /// others are marked as shed. Nodes and edges are left out if no served agent depends on them. All other
    /// nodes and edges are bit-identical to the result without a limit.
    ///
    /// # Errors
    /// [`Rejected`] if the frame is not newer than the last, does not fit the model or holds impossible
    /// numbers. Nothing is then computed or cached.
    pub fn prepare(
        &mut self,
        header: &Header,
        context: &Context<'_>,
        served_max: Option<usize>,
    ) -> Result<FeatureShape, Rejected> {
        if !header.is_tick() {
            header.check()?;
            self.frame.clear();
            return Ok(FeatureShape { agents_len: 0, edges_len: 0 });
        }
        self.check(header, context)?;
        if self
            .last
            .is_some_and(|(run_id, last)| run_id != header.run_id || header.begins_session_after(last))
        {
            self.cache.clear();
            self.queue.clear();
        }
        self.last = Some((header.run_id, (header.seq, header.stamp_ns)));
        self.place_agents(context);
        if let Some(served_max) = served_max {
            self.queue.choose(header, context.tracks, served_max, &mut self.frame.agents);
        }
        self.find_edges();
        self.leave_out();
        self.embed(header, context);
        Ok(FeatureShape { agents_len: self.frame.agents.len(), edges_len: self.frame.edges.len() })
    }

    /// Writes the features that [`Extractor::prepare`] computed.
    ///
    /// # Panics
    /// If the shape of `out` differs from the shape that `prepare` returned.
    pub fn write(&mut self, out: &mut FeaturesMut<'_>) {
        out.agents.copy_from_slice(&self.frame.agents);
        out.edges.copy_from_slice(&self.frame.edges);
        out.attributes.copy_from_slice(&self.frame.attributes);
    }

    fn check(&self, header: &Header, context: &Context<'_>) -> Result<(), Rejected> {
        header.check_agents(context.tracks.len())?;
        if let Some((run_id, last)) = self.last
            && run_id == header.run_id
            && header.stamp_ns <= last.1
            && !header.begins_session_after(last)
        {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns: last.1 });
        }
        let ContextShape { agents_len, history_len, patch_side } = context.shape;
        equal("agents_len", context.tracks.len(), agents_len)?;
        equal("history_len", history_len, self.config.history_len)?;
        if self.config.context {
            equal("patch_side", patch_side, self.config.patch_size)?;
        }
        equal("step_ns", header.step_ns as usize, self.config.step_ns() as usize)?;
        for (i, track) in context.tracks.iter().enumerate() {
            track.check()?;
            if context.tracks[..i].iter().any(|other| other.id == track.id) {
                return Err(Rejected::Twice { field: "track", id: track.id });
            }
        }
        finite("context patches", context.patches)
    }

    /// Fills in the states and state features of all agents.
    fn place_agents(&mut self, context: &Context<'_>) {
        let Frame { agents, states, .. } = &mut self.frame;
        agents.clear();
        states.clear();
        for track in context.tracks {
            let mut history = scene::track_history(track);
            history[self.config.history_len..].fill(None);
            let frame = scene::agent_frame(&history);
            agents.push(describe(track, &history, frame.as_ref(), self.scales));
            states.push(history);
        }
    }

    /// Finds the edges of all steps. If they do not fit the frame, each agent keeps only its nearest
    /// neighbours.
    fn find_edges(&mut self) {
        self.append_edges(self.rule);
        self.effort = Effort::default();
        let found = self.frame.edges.len();
        if found > EDGES_MAX {
            self.append_edges(EdgeRule { neighbours_max: NEIGHBOURS_MAX, ..self.rule });
            self.effort.edges_dropped = found - self.frame.edges.len();
        }
    }

    /// Leaves out the edges on which no served agent depends, and finds the nodes on which served agents
    /// depend.
    fn leave_out(&mut self) {
        let Frame { agents, edges, needed, .. } = &mut self.frame;
        needed.clear();
        if agents.iter().all(|agent| agent.shed == 0) {
            return;
        }
        let mut served = [false; AGENTS_MAX];
        for (served, agent) in served.iter_mut().zip(agents.iter()) {
            *served = agent.forecastable != 0 && agent.shed == 0;
        }
        // Each round of attention reads the senders of its receivers, so the first round needs the most
        // agents.
        let receivers = |step: usize| {
            let of_step = &edges[span(edges, step)];
            (1..self.config.rounds).fold(served, |receivers, _| with_senders(&receivers, of_step))
        };
        let mut received = [[false; AGENTS_MAX]; HISTORY_MAX];
        for (step, received) in received[..self.config.history_len].iter_mut().enumerate() {
            *received = receivers(step);
            needed.push(with_senders(received, &edges[span(edges, step)]));
        }
        edges.retain(|edge| received[usize::from(edge.step)][usize::from(edge.receiver)]);
    }

    fn append_edges(&mut self, rule: EdgeRule) {
        let Frame { agents, edges, states, vertices, .. } = &mut self.frame;
        edges.clear();
        for step in 0..self.config.history_len {
            vertices.clear();
            vertices.extend(states.iter().zip(agents.iter()).map(|(states, agent)| {
                let agent_type = agent_type(agent);
                states[step].map(|state| Vertex { position_m: state.position_m, agent_type })
            }));
            rule.append(step as u16, vertices, edges);
        }
    }

    /// Fills in the state embeddings of all present nodes, and the context and relation embeddings of all
    /// steps. Context and relation embeddings come from the cache, or are computed and then cached.
    fn embed(&mut self, header: &Header, context: &Context<'_>) {
        let Frame { agents, edges, attributes, states, needed, wanted, .. } = &mut self.frame;
        let is_needed = |agent: usize, step: usize| needed.get(step).is_none_or(|needed| needed[agent]);
        let history_len = self.config.history_len;
        attributes.clear();
        attributes.resize(edges.len(), [0.0; EDGE_ATTRIBUTES]);
        wanted.clear();
        for of_type in AGENT_TYPES {
            for (i, agent) in agents.iter().enumerate().filter(|(_, agent)| agent_type(agent) == of_type) {
                let present = (0..history_len).filter(|step| agent.is_present(*step));
                let steps = present.filter(|step| is_needed(i, *step));
                steps.for_each(|step| wanted.state(i, step, of_type));
            }
        }
        let stamp_ns = |step: usize| {
            let back = (history_len - 1 - step) as i64;
            header.stamp_ns.saturating_sub(back.saturating_mul(header.step_ns as i64))
        };
        for step in 0..history_len {
            let kept = self.cache.at(stamp_ns(step), agents);
            if self.config.context {
                let present = agents.iter_mut().enumerate().filter(|(_, a)| a.is_present(step));
                for (i, agent) in present.filter(|(i, _)| is_needed(*i, step)) {
                    match kept.as_ref().and_then(|kept| kept.context(i)) {
                        Some(context) => *context_of(&mut agent.node[step]) = *context,
                        None => wanted.patch(i, step),
                    }
                }
            }
            for edge in span(edges, step) {
                match kept.as_ref().and_then(|kept| kept.relation(&edges[edge])) {
                    Some(relation) => attributes[edge] = *relation,
                    None => wanted.relation(edge, step),
                }
            }
        }
        let scales = self.scales;
        let relation = |edge: usize| {
            let Edge { step, receiver, sender, .. } = edges[edge];
            let state = |agent: u16| states[usize::from(agent)][usize::from(step)].unwrap_or_default();
            scene::relation_features(&state(receiver), &state(sender), scales)
        };
        let state = |agent: usize, step: usize| agents[agent].state[step];
        embed::run(&mut self.embedders, wanted, context, state, relation);
        embed::collect(&mut self.embedders, wanted, |embedding| match embedding {
            Embedding::State { agent, step, values } => {
                agents[agent].node[step][..values.len()].copy_from_slice(values);
            }
            Embedding::Context { agent, step, values } => {
                *context_of(&mut agents[agent].node[step]) = *values;
            }
            Embedding::Relation { edge, values } => attributes[edge] = *values,
        });
        for step in wanted.steps() {
            let of_step = span(edges, step);
            let is_computed = |agent: usize| agents[agent].is_present(step) && is_needed(agent, step);
            let (edges, relations) = (&edges[of_step.clone()], &attributes[of_step]);
            self.cache.keep(stamp_ns(step), step, agents, is_computed, edges, relations);
        }
        self.effort.patch_count = wanted.patch_count();
        self.effort.relation_count = wanted.relation_count();
    }
}

/// The range of a step's edges.
fn span(edges: &[Edge], step: usize) -> std::ops::Range<usize> {
    let step = step as u16;
    edges.partition_point(|edge| edge.step < step)..edges.partition_point(|edge| edge.step <= step)
}

/// The second half of a node attribute, which holds CE.
fn context_of(node: &mut [f32; NODE_ATTRIBUTES]) -> &mut [f32; CONTEXT_EMBEDDING] {
    node.last_chunk_mut().expect("a node holds a context embedding")
}

/// An agent with state features, but without node attributes.
fn describe(
    track: &wire::Track,
    history: &[Option<State>; HISTORY_MAX],
    frame: Option<&AgentFrame>,
    scales: FeatureScales,
) -> AgentFeatures {
    let mut agent = AgentFeatures::of(track);
    for (step, state) in history.iter().enumerate() {
        if let (Some(frame), Some(state)) = (frame, state) {
            agent.present |= 1 << step;
            agent.state[step] = scene::state_features(frame, state, scales);
        }
    }
    agent
}

/// The type of an agent whose track has been checked.
fn agent_type(agent: &AgentFeatures) -> AgentType {
    AgentType::try_from(agent.agent_type).expect("the track's type was checked")
}
