//! What the protocols of windows share: their rules.

use super::{Baselines, Block, Judge, Subset};
use crate::error::EvaluateError;
use crate::footage::{Footage, Options, SEED};
use crate::forecaster::{MapInput, Model};
use crate::lines::ForecastLines;
use crate::scenes::Cut;

impl Options {
    /// The rules of a protocol.
    pub(crate) fn rules<'a>(
        &'a self,
        horizons: &'a [usize],
        subsets: &'a [Subset],
        of_type: Option<scene::AgentType>,
    ) -> Rules<'a> {
        Rules { horizons, subsets, of_type, threads: self.threads, lines: self.lines.as_deref() }
    }
}

/// A protocol's counted agents and horizons.
#[derive(Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub(crate) horizons: &'a [usize],
    pub(crate) subsets: &'a [Subset],
    pub(crate) of_type: Option<scene::AgentType>,
    pub(crate) threads: usize,
    pub(crate) lines: Option<&'a ForecastLines>,
}

impl<'a> Rules<'a> {
    /// Evaluates a recording; a recording without a counted agent is accepted.
    pub(crate) fn judge(
        &self,
        model: &'a Model,
        baselines: &'a Baselines,
        footage: &Footage,
        map: MapInput<'_>,
        part: &str,
    ) -> Vec<Block> {
        self.judge_with(model, baselines, part).recording(&footage.recording, &footage.scenes, map, None)
    }

    /// The evaluation of a model with these rules. `part` names the agents in the lines of forecasts.
    pub(crate) fn judge_with(&self, model: &'a Model, baselines: &'a Baselines, part: &str) -> Judge<'a> {
        Judge { forecaster: &model.forecaster, baselines, rules: *self, lanes: None, part: part.to_owned() }
    }

    /// The horizons in seconds.
    pub(crate) fn horizons_s(&self, cut: &Cut) -> Vec<f64> {
        self.horizons.iter().map(|&steps| (steps as i64 * cut.step_ns()) as f64 / 1e9).collect()
    }

    /// Index of the longest horizon.
    pub(crate) const fn last(&self) -> usize {
        self.horizons.len() - 1
    }
}

pub(crate) fn fit(training: &[Footage], cut: &Cut) -> Baselines {
    Baselines::fit(training.iter().flat_map(|footage| &footage.scenes), cut, SEED)
}

/// Fails if the recordings have no counted agent.
pub(crate) fn need_agents(blocks: &[Block], name: &str, cut: &Cut) -> Result<(), EvaluateError> {
    if blocks.iter().any(|block| block.tallies.iter().any(|tally| !tally.is_empty())) {
        return Ok(());
    }
    let steps = cut.history_len + cut.horizon_len;
    Err(EvaluateError::NoWindows { name: name.to_owned(), steps, dt_s: cut.dt_s })
}
