//! Evidence of single recordings, which merges into the priors of many.

use std::collections::BTreeMap;

use data::Recording;
use evidence::{BANDS, Context, KNOTS, Prior, Priors};
use nn::ModelConfig;
use run::Run;
use scene::AgentType;

use crate::driving::{EVERY_NS, Residual, Residuals, patterns};
use crate::error::EvaluateError;
use crate::fleet::{Outcome, outcomes};

/// Maximum number of residuals of a recording per type and speed.
const RESIDUALS_MAX: usize = 60;

/// What one recording shows the experts to be worth.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learned {
    prior: Prior,
    residuals: Vec<(u32, f32, [[f32; 2]; KNOTS])>,
}

/// Plays a recording from empty evidence, so that its result depends on nothing else.
///
/// # Errors
/// [`EvaluateError`] if the stages can't be set up.
pub fn learn(recording: Recording, run: &Run, model: &ModelConfig) -> Result<Learned, EvaluateError> {
    let (outcomes, prior) = outcomes(recording, run, model, Some(Prior::default()))?;
    Ok(Learned { prior: prior.unwrap_or_default(), residuals: residuals(&outcomes.rows) })
}

fn residuals(rows: &[Outcome]) -> Vec<(u32, f32, [[f32; 2]; KNOTS])> {
    let mut counted_ns: BTreeMap<u64, i64> = BTreeMap::new();
    let mut of_bands: [[Vec<_>; BANDS]; 3] = Default::default();
    for row in rows {
        let Some(errors) = row.errors else { continue };
        if counted_ns.get(&row.agent).is_some_and(|last_ns| row.stamp_ns < last_ns + EVERY_NS) {
            continue;
        }
        counted_ns.insert(row.agent, row.stamp_ns);
        let band = Context::new(row.agent_type, row.speed_mps).nearest();
        of_bands[row.agent_type.index()][band].push((
            row.agent_type as u32,
            row.speed_mps,
            errors.residuals_m,
        ));
    }
    let few = |of_band: Vec<_>| {
        let stride = of_band.len().div_ceil(RESIDUALS_MAX).max(1);
        of_band.into_iter().step_by(stride)
    };
    of_bands.into_iter().flatten().flat_map(few).collect()
}

/// The priors of sources, each with its recordings: the mean of a source's evidence, and the patterns of all.
#[must_use]
pub fn priors(sources: &BTreeMap<String, Vec<Learned>>) -> Priors {
    let prior = |recordings: &Vec<Learned>| {
        Priors::source(&recordings.iter().map(|of| of.prior.clone()).collect::<Vec<_>>())
    };
    let residuals: Vec<Residuals> =
        sources.values().map(|recordings| Residuals::of(&all(recordings))).collect();
    Priors {
        sources: sources.iter().map(|(name, recordings)| (name.clone(), prior(recordings))).collect(),
        pattern: patterns(&residuals.iter().collect::<Vec<_>>()),
        pattern_without: BTreeMap::new(),
    }
}

fn all(recordings: &[Learned]) -> Vec<Residual> {
    let residuals = recordings.iter().flat_map(|of| &of.residuals);
    residuals
        .filter_map(|&(agent_type, speed_mps, residuals_m)| {
            let agent_type = AgentType::try_from(agent_type).ok()?;
            Some(Residual { agent_type, speed_mps, residuals_m })
        })
        .collect()
}
