//! Patches and pairs that must go through a network, shared among the workers.

use std::ops::Range;
use std::sync::Arc;

use nn::{ContextCnn, ContextMemory, Job, MlpMemory, RelationMlp, Weights, Workers};
use wire::{CONTEXT_EMBEDDING, Context, EDGE_ATTRIBUTES, HISTORY_MAX, RELATION_FEATURES};

use crate::StartError;

/// What must be computed for a frame.
#[derive(Default)]
pub(crate) struct Wanted {
    /// (agent, step) whose context embedding is not cached.
    patches: Vec<(usize, usize)>,
    /// Edges whose relation embedding is not cached.
    relations: Vec<usize>,
    /// Steps of these.
    steps: [bool; HISTORY_MAX],
}

/// A result, with its place.
pub(crate) enum Embedding<'a> {
    /// A context embedding.
    Context { agent: usize, step: usize, values: &'a [f32; CONTEXT_EMBEDDING] },
    /// A relation embedding.
    Relation { edge: usize, values: &'a [f32; EDGE_ATTRIBUTES] },
}

impl Wanted {
    pub(crate) fn clear(&mut self) {
        self.patches.clear();
        self.relations.clear();
        self.steps.fill(false);
    }

    pub(crate) fn patch(&mut self, agent: usize, step: usize) {
        self.patches.push((agent, step));
        self.steps[step] = true;
    }

    pub(crate) fn relation(&mut self, edge: usize, step: usize) {
        self.relations.push(edge);
        self.steps[step] = true;
    }

    pub(crate) const fn patches_len(&self) -> usize {
        self.patches.len()
    }

    pub(crate) const fn relations_len(&self) -> usize {
        self.relations.len()
    }

    pub(crate) fn steps(&self) -> impl Iterator<Item = usize> {
        self.steps.iter().enumerate().filter(|(_, wanted)| **wanted).map(|(step, _)| step)
    }
}

struct Networks {
    /// None where nodes carry no context.
    context: Option<ContextCnn>,
    relation: RelationMlp,
}

/// One worker's share of a frame.
pub(crate) struct Embedder {
    networks: Arc<Networks>,
    patches: Vec<f32>,
    contexts: Vec<[f32; CONTEXT_EMBEDDING]>,
    features: Vec<[f32; RELATION_FEATURES]>,
    relations: Vec<[f32; EDGE_ATTRIBUTES]>,
    context_memory: ContextMemory,
    mlp_memory: MlpMemory,
}

impl Embedder {
    /// As many embedders as there are workers.
    pub(crate) fn pool(weights: &Weights, workers: usize) -> Result<Workers<Self>, StartError> {
        let context = weights.config().context.then(|| ContextCnn::new(weights)).transpose()?;
        let networks = Arc::new(Networks { context, relation: RelationMlp::new(weights)? });
        let embedder = |_| Self {
            networks: Arc::clone(&networks),
            patches: Vec::new(),
            contexts: Vec::new(),
            features: Vec::new(),
            relations: Vec::new(),
            context_memory: ContextMemory::default(),
            mlp_memory: MlpMemory::default(),
        };
        Ok(Workers::new((0..workers).map(embedder))?)
    }
}

impl Job for Embedder {
    fn run(&mut self) {
        if let Some(cnn) = &self.networks.context {
            cnn.embed(&self.patches, &mut self.context_memory, &mut self.contexts);
        }
        self.networks.relation.embed(&self.features, &mut self.mlp_memory, &mut self.relations);
    }
}

/// The part of `len` rows that is worker `number`'s.
fn share(len: usize, number: usize, workers: usize) -> Range<usize> {
    len * number / workers..len * (number + 1) / workers
}

/// Computes all that is wanted and calls `take` with each result.
pub(crate) fn run(
    workers: &mut Workers<Embedder>,
    wanted: &Wanted,
    context: &Context<'_>,
    relation: impl Fn(usize) -> [f32; RELATION_FEATURES],
    mut take: impl FnMut(Embedding<'_>),
) {
    let workers_len = workers.len();
    let shares = |number: usize| {
        let patches = &wanted.patches[share(wanted.patches.len(), number, workers_len)];
        let relations = &wanted.relations[share(wanted.relations.len(), number, workers_len)];
        (patches, relations)
    };
    workers.each(|number, job| {
        let (patches, relations) = shares(number);
        job.patches.clear();
        for &(agent, step) in patches {
            job.patches.extend_from_slice(context.patch(agent, step));
        }
        job.contexts.resize(patches.len(), [0.0; CONTEXT_EMBEDDING]);
        job.features.clear();
        job.features.extend(relations.iter().map(|&edge| relation(edge)));
        job.relations.resize(relations.len(), [0.0; EDGE_ATTRIBUTES]);
    });
    workers.run();
    workers.each(|number, job| {
        let (patches, relations) = shares(number);
        for (&(agent, step), values) in patches.iter().zip(&job.contexts) {
            take(Embedding::Context { agent, step, values });
        }
        for (&edge, values) in relations.iter().zip(&job.relations) {
            take(Embedding::Relation { edge, values });
        }
    });
}
