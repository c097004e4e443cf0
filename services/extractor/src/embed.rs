//! Runs states, patches and pairs through the networks, distributed among the workers.

use std::ops::Range;
use std::sync::Arc;

use nn::{ContextCnn, ContextMemory, Job, MlpMemory, RelationMlp, StartError, StateMlp, Weights, Workers};
use wire::{
    AgentType, CONTEXT_EMBEDDING, Context, EDGE_ATTRIBUTES, HISTORY_MAX, RELATION_FEATURES, STATE_FEATURES,
};

/// Patches in one CNN batch. The number fills whole register tiles on every instruction set.
const PATCHES: usize = 12;
/// States or pairs in one MLP batch.
const ROWS: usize = 96;

/// The embeddings to compute for a frame.
#[derive(Default)]
pub(crate) struct Wanted {
    /// (agent, step, type) of all states, grouped by type.
    states: Vec<(usize, usize, AgentType)>,
    /// (agent, step) of each context embedding that is not cached.
    patches: Vec<(usize, usize)>,
    /// Edges whose relation embedding is not cached.
    relations: Vec<usize>,
    /// The steps of `patches` and `relations`.
    steps: [bool; HISTORY_MAX],
}

/// A result and its place in the frame.
pub(crate) enum Embedding<'a> {
    /// A state embedding.
    State { agent: usize, step: usize, values: &'a [f32] },
    /// A context embedding.
    Context { agent: usize, step: usize, values: &'a [f32; CONTEXT_EMBEDDING] },
    /// A relation embedding.
    Relation { edge: usize, values: &'a [f32; EDGE_ATTRIBUTES] },
}

impl Wanted {
    pub(crate) fn clear(&mut self) {
        self.states.clear();
        self.patches.clear();
        self.relations.clear();
        self.steps.fill(false);
    }

    pub(crate) fn state(&mut self, agent: usize, step: usize, agent_type: AgentType) {
        self.states.push((agent, step, agent_type));
    }

    pub(crate) fn patch(&mut self, agent: usize, step: usize) {
        self.patches.push((agent, step));
        self.steps[step] = true;
    }

    pub(crate) fn relation(&mut self, edge: usize, step: usize) {
        self.relations.push(edge);
        self.steps[step] = true;
    }

    pub(crate) const fn patch_count(&self) -> usize {
        self.patches.len()
    }

    pub(crate) const fn relation_count(&self) -> usize {
        self.relations.len()
    }

    pub(crate) fn steps(&self) -> impl Iterator<Item = usize> {
        self.steps.iter().enumerate().filter(|(_, wanted)| **wanted).map(|(step, _)| step)
    }
}

struct Networks {
    state: StateMlp,
    /// Length of a state embedding.
    state_len: usize,
    /// `None` if nodes have no context.
    context: Option<ContextCnn>,
    relation: RelationMlp,
}

/// Inputs of the networks for a frame.
#[derive(Default)]
pub(crate) struct Inputs {
    states: Vec<[f32; STATE_FEATURES]>,
    patches: Vec<f32>,
    relations: Vec<[f32; RELATION_FEATURES]>,
    blocks: Vec<Block>,
}

/// Rows that one worker embeds together.
#[derive(Clone)]
enum Block {
    Patches(Range<usize>),
    Relations(Range<usize>),
    States(AgentType, Range<usize>),
}

/// A worker: its scratch memory and the embeddings of the blocks that it computed.
pub(crate) struct Embedder {
    networks: Arc<Networks>,
    states: Vec<f32>,
    contexts: Vec<[f32; CONTEXT_EMBEDDING]>,
    relations: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// The blocks, in the order of their embeddings.
    done: Vec<Block>,
    context_memory: ContextMemory,
    mlp_memory: MlpMemory,
}

impl Embedder {
    /// One embedder for each worker.
    pub(crate) fn pool(weights: &Weights, workers: usize) -> Result<Workers<Self>, StartError> {
        let config = weights.config();
        let networks = Arc::new(Networks {
            state: StateMlp::new(weights)?,
            state_len: config.state_embedding_len(),
            context: config.context.then(|| ContextCnn::new(weights)).transpose()?,
            relation: RelationMlp::new(weights)?,
        });
        let embedder = |_| Self {
            networks: Arc::clone(&networks),
            states: Vec::new(),
            contexts: Vec::new(),
            relations: Vec::new(),
            done: Vec::new(),
            context_memory: ContextMemory::default(),
            mlp_memory: MlpMemory::default(),
        };
        // Any worker may get any block, so each allocates its scratch memory now.
        let warm = |mut embedder: Self| {
            embedder.warm_up();
            embedder
        };
        Ok(Workers::new(Inputs::default(), (0..workers).map(embedder).map(warm))?)
    }

    fn warm_up(&mut self) {
        let patches = self.networks.context.as_ref().map_or(0, |cnn| PATCHES * cnn.patch_len());
        let inputs = Inputs {
            states: vec![[0.0; STATE_FEATURES]; ROWS],
            patches: vec![0.0; patches],
            relations: vec![[0.0; RELATION_FEATURES]; ROWS],
            blocks: [Block::Relations(0..ROWS), Block::States(AgentType::Vehicle, 0..ROWS)]
                .into_iter()
                .chain((patches > 0).then_some(Block::Patches(0..PATCHES)))
                .collect(),
        };
        (0..inputs.blocks.len()).for_each(|block| self.run(&inputs, block));
        self.clear();
    }

    fn clear(&mut self) {
        self.states.clear();
        self.contexts.clear();
        self.relations.clear();
        self.done.clear();
    }

    /// Reserves memory for the embeddings of a whole frame.
    fn reserve(&mut self, inputs: &Inputs, patch_count: usize) {
        self.states.reserve(inputs.states.len() * self.networks.state_len);
        self.contexts.reserve(patch_count);
        self.relations.reserve(inputs.relations.len());
        self.done.reserve(inputs.blocks.len());
    }
}

impl Job for Embedder {
    type Input = Inputs;

    fn run(&mut self, inputs: &Inputs, block: usize) {
        let block = inputs.blocks[block].clone();
        match &block {
            Block::Patches(rows) => {
                let cnn = self.networks.context.as_ref().expect("patches are wanted for a CNN alone");
                let first = self.contexts.len();
                self.contexts.resize(first + rows.len(), [0.0; CONTEXT_EMBEDDING]);
                let patches = &inputs.patches[rows.start * cnn.patch_len()..rows.end * cnn.patch_len()];
                cnn.embed(patches, &mut self.context_memory, &mut self.contexts[first..]);
            }
            Block::Relations(rows) => {
                let first = self.relations.len();
                self.relations.resize(first + rows.len(), [0.0; EDGE_ATTRIBUTES]);
                let relations = &inputs.relations[rows.clone()];
                self.networks.relation.embed(relations, &mut self.mlp_memory, &mut self.relations[first..]);
            }
            Block::States(agent_type, rows) => {
                let first = self.states.len();
                self.states.resize(first + rows.len() * self.networks.state_len, 0.0);
                let (states, out) = (&inputs.states[rows.clone()], &mut self.states[first..]);
                self.networks.state.embed(*agent_type, states, &mut self.mlp_memory, out);
            }
        }
        self.done.push(block);
    }
}

/// Splits the rows into blocks of at most `most`.
fn blocks(rows: Range<usize>, most: usize) -> impl Iterator<Item = Range<usize>> {
    let end = rows.end;
    rows.step_by(most).map(move |first| first..end.min(first + most))
}

/// Computes all wanted embeddings from states, patches and relations.
pub(crate) fn run(
    workers: &mut Workers<Embedder>,
    wanted: &Wanted,
    context: &Context<'_>,
    state: impl Fn(usize, usize) -> [f32; STATE_FEATURES],
    relation: impl Fn(usize) -> [f32; RELATION_FEATURES],
) {
    let mut inputs = std::mem::take(&mut *workers.input());
    inputs.fill(wanted, context, state, relation);
    let block_count = inputs.blocks.len();
    workers.each(|job| {
        job.clear();
        job.reserve(&inputs, wanted.patches.len());
    });
    *workers.input() = inputs;
    workers.run(block_count);
}

/// Calls `take` with each result of [`run`].
pub(crate) fn collect(workers: &mut Workers<Embedder>, wanted: &Wanted, mut take: impl FnMut(Embedding<'_>)) {
    workers.each(|job| {
        let state_len = job.networks.state_len;
        let mut states = job.states.chunks_exact(state_len);
        let (mut contexts, mut relations) = (job.contexts.iter(), job.relations.iter());
        for block in &job.done {
            match block {
                Block::Patches(rows) => {
                    for (&(agent, step), values) in wanted.patches[rows.clone()].iter().zip(&mut contexts) {
                        take(Embedding::Context { agent, step, values });
                    }
                }
                Block::Relations(rows) => {
                    for (&edge, values) in wanted.relations[rows.clone()].iter().zip(&mut relations) {
                        take(Embedding::Relation { edge, values });
                    }
                }
                Block::States(_, rows) => {
                    for (&(agent, step, _), values) in wanted.states[rows.clone()].iter().zip(&mut states) {
                        take(Embedding::State { agent, step, values });
                    }
                }
            }
        }
    });
}

impl Inputs {
    fn fill(
        &mut self,
        wanted: &Wanted,
        context: &Context<'_>,
        state: impl Fn(usize, usize) -> [f32; STATE_FEATURES],
        relation: impl Fn(usize) -> [f32; RELATION_FEATURES],
    ) {
        self.states.clear();
        self.states.extend(wanted.states.iter().map(|&(agent, step, _)| state(agent, step)));
        self.patches.clear();
        for &(agent, step) in &wanted.patches {
            self.patches.extend_from_slice(context.patch(agent, step));
        }
        self.relations.clear();
        self.relations.extend(wanted.relations.iter().map(|&edge| relation(edge)));
        // The costliest blocks first: small blocks at the end shorten the time that workers wait for each
        // other.
        self.blocks.clear();
        self.blocks.extend(blocks(0..wanted.patches.len(), PATCHES).map(Block::Patches));
        self.blocks.extend(blocks(0..wanted.relations.len(), ROWS).map(Block::Relations));
        let mut first = 0;
        for of_type in wanted.states.chunk_by(|a, b| a.2 == b.2) {
            let rows = first..first + of_type.len();
            self.blocks.extend(blocks(rows, ROWS).map(|rows| Block::States(of_type[0].2, rows)));
            first += of_type.len();
        }
    }
}
