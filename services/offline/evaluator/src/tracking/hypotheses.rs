//! What the model says of how each agent will be steered.

use std::collections::BTreeMap;

use filters::ControlStep;
use retrieval::{ControlChanges, Query, Retrieval, RetrievalMemory};
use scene::{OnlineMap, State};
use wire::{AgentType, CONTEXT_EMBEDDING};

use crate::forecaster::Said;
use crate::maps::MapInput;
use crate::{Agent, Forecaster, ForecasterMemory, Scene, motion};

/// Controls of all modes of one agent, as [`filters::Forecast`] wants them.
#[derive(Clone, Debug)]
pub(crate) struct Hypotheses {
    pub(crate) heading_rad: f64,
    pub(crate) probability: Vec<f64>,
    pub(crate) controls: Vec<ControlStep>,
}

/// What a filter believes of an agent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Estimate {
    pub(crate) id: u64,
    pub(crate) agent_type: AgentType,
    pub(crate) length_m: Option<f32>,
    pub(crate) state: State,
    /// Whether it is measured at this instant.
    pub(crate) is_seen: bool,
    /// Whether a forecast of the agent is wanted.
    pub(crate) wanted: bool,
}

/// What is known of a place before anything is seen there.
#[derive(Clone, Debug)]
pub(crate) struct Place<'a> {
    /// An online map is of what filters believed so far.
    pub(crate) map: MapInput<'a>,
    /// What those who came by earlier did, if anybody remembers.
    pub(crate) memory: Option<RetrievalMemory>,
}

/// Estimates at a stamp with their contexts.
type Past = BTreeMap<i64, (State, [f32; CONTEXT_EMBEDDING])>;

/// Forecasts from estimates: a model that is shown what filters believed, instant after instant, at a place.
pub(crate) struct Oracle<'a> {
    forecaster: &'a Forecaster,
    map: MapInput<'a>,
    online: OnlineMap,
    retrieval: Option<Retrieval>,
    memory: ForecasterMemory,
    /// The context where no map tells anything.
    unknown: [f32; CONTEXT_EMBEDDING],
    pasts: BTreeMap<u64, Past>,
}

impl<'a> Oracle<'a> {
    /// An oracle that has seen nothing yet; it remembers the place only if it `revisits` it.
    pub(crate) fn new(forecaster: &'a Forecaster, place: &Place<'a>, revisits: bool) -> Self {
        let empty = forecaster.patch_options().map_or_else(Vec::new, |options| vec![0.0; options.len()]);
        let unknown = forecaster.embed_patches(&empty).first().copied();
        Self {
            forecaster,
            map: place.map,
            online: OnlineMap::new(),
            retrieval: place.memory.clone().filter(|_| revisits).map(Retrieval::new),
            memory: ForecasterMemory::default(),
            unknown: unknown.unwrap_or([0.0; CONTEXT_EMBEDDING]),
            pasts: BTreeMap::new(),
        }
    }

    /// Takes in what is believed now, with the sensor at `ego_m`, and forecasts those who are wanted.
    ///
    /// Estimates stay as they were when they were made, as on board. A history has those that were made whole steps of the
    /// model ago.
    pub(crate) fn forecast(
        &mut self,
        now_ns: i64,
        ego_m: [f32; 2],
        estimates: &[Estimate],
    ) -> Vec<(u64, Hypotheses)> {
        let contexts = self.contexts(ego_m, estimates);
        for (estimate, context) in estimates.iter().zip(contexts) {
            self.pasts.entry(estimate.id).or_default().insert(now_ns, (estimate.state, context));
        }
        let config = self.forecaster.config();
        let step_ns = config.step_ns().cast_signed();
        let history_len = config.history_len as i64;
        let stamp_ns = |step: i64| now_ns - (history_len - 1 - step) * step_ns;
        self.pasts.retain(|_, past| {
            past.retain(|&past_ns, _| past_ns >= stamp_ns(0));
            !past.is_empty()
        });
        let past = |estimate: &Estimate, step: i64| self.pasts[&estimate.id].get(&stamp_ns(step));
        let agents = estimates.iter().map(|estimate| Agent {
            id: estimate.id,
            agent_type: estimate.agent_type,
            length_m: estimate.length_m,
            history: (0..history_len).map(|step| past(estimate, step).map(|past| past.0)).collect(),
            future: Vec::new(),
        });
        let scene = Scene { stamp_ns: now_ns, agents: agents.collect() };
        let wanted: Vec<usize> = (0..estimates.len()).filter(|&agent| estimates[agent].wanted).collect();
        let context = |agent: usize, step: usize| {
            past(&estimates[agent], step as i64).map_or(self.unknown, |past| past.1)
        };
        let said = self.forecaster.say(&scene, context, &wanted, &mut self.memory);
        if let Some(retrieval) = &mut self.retrieval {
            let seen = estimates.iter().filter(|estimate| estimate.is_seen);
            retrieval.observe(now_ns, seen.map(|estimate| (estimate.id, estimate.state.position_m)));
        }
        let steer = |(&place, said): (&usize, &Said)| {
            let agent = &scene.agents[place];
            let changes = self.retrieve(now_ns, agent, said);
            (agent.id, self.forecaster.steer(agent, said, changes.as_ref()))
        };
        wanted.iter().zip(&said).map(steer).collect()
    }

    /// What an agent's controls are changed by, which is stored from now on.
    fn retrieve(&mut self, stamp_ns: i64, agent: &Agent, said: &Said) -> Option<ControlChanges> {
        let (config, retrieval) = (self.forecaster.config(), self.retrieval.as_mut()?);
        let query = Query { stamp_ns, agent: agent.id, key: motion::key(agent, config)? };
        let (model, controls) = (motion::model(agent, config), self.forecaster.controls(said));
        let mut changes = ControlChanges::default();
        retrieval.adapt(&query, &model, &controls, &mut changes);
        Some(changes)
    }

    /// The context embeddings of estimates, in their order, which an online map then takes in.
    fn contexts(&mut self, ego_m: [f32; 2], estimates: &[Estimate]) -> Vec<[f32; CONTEXT_EMBEDDING]> {
        let options = self.forecaster.patch_options().filter(|_| !matches!(self.map, MapInput::None));
        let Some(options) = options else { return vec![self.unknown; estimates.len()] };
        let mut patches = vec![0.0; options.len() * estimates.len()];
        for (estimate, patch) in estimates.iter().zip(patches.chunks_exact_mut(options.len())) {
            match self.map {
                MapInput::Site(map) => map.patch(&estimate.state, options, patch),
                MapInput::Online | MapInput::None => self.online.patch(&estimate.state, options, patch),
            }
        }
        if matches!(self.map, MapInput::Online) {
            let seen = estimates.iter().filter(|estimate| estimate.is_seen).map(|estimate| estimate.state);
            self.online.observe(ego_m, seen.map(|state| (state.position_m, state.velocity_mps)));
        }
        self.forecaster.embed_patches(&patches)
    }
}
