use extractor::Extractor;
use localiser::Localiser;
use nn::Weights;
use run::Run;
use sampler::Sampler;
use sampler::journal::{Identity, Journal, Storage};
use tracker::Tracker;
use wire::StageId;

use crate::graph::Node;
use crate::{ChainError, Graph, open_all};

/// The compute stages of a recorded run. A stage can be renewed alone, as its process is when it is restarted.
pub struct Stages {
    pub(crate) graph: Graph,
    run: Run,
    weights: Weights,
}

impl Stages {
    /// Sets up all stages of a run from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, weights: Weights) -> Result<Self, ChainError> {
        let nodes = open_all(run, &weights)?;
        Ok(Self::of(nodes, run, weights))
    }

    /// Joins stages of a run.
    ///
    /// # Panics
    /// As [`Graph::new`].
    #[must_use]
    pub fn of(nodes: Vec<Box<dyn Node>>, run: &Run, weights: Weights) -> Self {
        let mut graph = Graph::new(nodes);
        if let Some(sampler) = graph.step_mut::<Sampler>() {
            sampler.keep_in(journal(run, sampler));
        }
        Self { graph, run: run.clone(), weights }
    }

    /// Replaces a stage by a new one, as a restart of its process does; `incarnation` counts these restarts.
    /// Encoder and decoder are kept, because they keep nothing from tick to tick.
    ///
    /// # Errors
    /// As [`Stages::new`].
    pub fn renew(&mut self, stage: StageId, incarnation: u32) -> Result<(), ChainError> {
        let Self { graph, run, weights } = self;
        let model = weights.config();
        match stage {
            StageId::Tracker => {
                graph.replace(Tracker::new(tracker::settings(run, model)?).with_ids_of(incarnation));
            }
            StageId::Localiser => graph.replace(Localiser::new(localiser::settings(run, model)?)),
            StageId::Extractor => graph.replace(Extractor::new(weights, extractor::settings(run)?)?),
            StageId::Sampler => {
                let journal = graph.step_mut().and_then(Sampler::take_journal);
                let mut sampler = sampler::open(run, model)?;
                sampler.keep_in(journal);
                graph.replace(sampler);
            }
            _ => {}
        }
        Ok(())
    }

    /// Resumes a new sampler with the state after `ticks` ticks of the previous one, or with an empty state
    /// if 0. Returns whether that state is known.
    pub fn resume_sampler(&mut self, ticks: u32) -> bool {
        self.graph.step_mut().is_some_and(|sampler: &mut Sampler| sampler.resume_after(ticks))
    }
}

/// The journal of the sampler's state, with the same identity as in the sampler's process; `None` if that
/// process keeps none.
fn journal(run: &Run, sampler: &Sampler) -> Option<Journal<Box<dyn Storage + Send>>> {
    let identity = Identity::of(run.id, sampler.options()).filter(|_| !run.lockstep)?;
    let memory: Box<dyn Storage + Send> = Box::new(Vec::<u64>::new());
    let mut journal = Journal::over(memory, identity);
    journal.clear().is_ok().then_some(journal)
}
