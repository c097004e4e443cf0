//! What the model says of how each agent will be steered.

use std::collections::BTreeMap;

use filters::ControlStep;
use scene::State;
use wire::{AgentType, CONTEXT_EMBEDDING};

use crate::{Agent, Forecaster, ForecasterMemory, Scene};

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
    /// Whether a forecast of the agent is wanted.
    pub(crate) wanted: bool,
}

/// Forecasts from estimates: a model that is shown what filters believed, instant after instant, and no map.
pub(crate) struct Oracle<'a> {
    forecaster: &'a Forecaster,
    /// That of a place of which no map tells.
    context: [f32; CONTEXT_EMBEDDING],
    memory: ForecasterMemory,
    /// Estimates of each agent by their stamp.
    pasts: BTreeMap<u64, BTreeMap<i64, State>>,
}

impl<'a> Oracle<'a> {
    /// An oracle that has seen nothing.
    pub(crate) fn new(forecaster: &'a Forecaster) -> Self {
        let empty = forecaster.patch_options().map_or_else(Vec::new, |options| vec![0.0; options.len()]);
        let context = forecaster.embed_patches(&empty).first().copied();
        Self {
            forecaster,
            context: context.unwrap_or([0.0; CONTEXT_EMBEDDING]),
            memory: ForecasterMemory::default(),
            pasts: BTreeMap::new(),
        }
    }

    /// Takes in what is believed now and forecasts those who are wanted.
    ///
    /// Estimates stay as they were when they were made, as on board. A history has those that were made whole steps of the
    /// model ago.
    pub(crate) fn forecast(&mut self, now_ns: i64, estimates: &[Estimate]) -> Vec<(u64, Hypotheses)> {
        for estimate in estimates {
            self.pasts.entry(estimate.id).or_default().insert(now_ns, estimate.state);
        }
        let Self { forecaster, context, memory, pasts } = self;
        let step_ns = forecaster.config().step_ns().cast_signed();
        let history_len = forecaster.config().history_len as i64;
        let stamps_ns = || (0..history_len).rev().map(|back| now_ns - back * step_ns);
        let oldest_ns = stamps_ns().next().unwrap_or(now_ns);
        pasts.retain(|_, past| {
            past.retain(|&stamp_ns, _| stamp_ns >= oldest_ns);
            !past.is_empty()
        });
        let agents = estimates.iter().map(|estimate| Agent {
            id: estimate.id,
            agent_type: estimate.agent_type,
            length_m: estimate.length_m,
            history: stamps_ns().map(|stamp_ns| pasts[&estimate.id].get(&stamp_ns).copied()).collect(),
            future: Vec::new(),
        });
        let scene = Scene { stamp_ns: now_ns, agents: agents.collect() };
        let wanted: Vec<usize> = (0..estimates.len()).filter(|&agent| estimates[agent].wanted).collect();
        let hypotheses = forecaster.steer(&scene, |_, _| *context, &wanted, memory);
        wanted.iter().map(|&agent| estimates[agent].id).zip(hypotheses).collect()
    }
}
