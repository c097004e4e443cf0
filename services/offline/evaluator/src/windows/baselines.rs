//! Forecasts without the network, for exactly the same agents.

use std::collections::BTreeMap;

use metrics::{Anchors, CVM_DRAWS, CVM_SIGMA_RAD};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::AgentType;

use super::Method;
use crate::forecaster::Variants;
use crate::lines::Candidate;
use crate::scenes::{Agent, Cut, Scene};

/// Maximum number of agents per type that anchors are fitted to, spread evenly over the training part.
const ANCHOR_AGENTS: usize = 60_000;

/// The baselines, with fitted anchors.
#[derive(Clone, Debug)]
pub struct Baselines {
    anchors: BTreeMap<AgentType, Anchors>,
    dt_s: f32,
    horizon_len: usize,
    seed: u64,
}

impl Baselines {
    /// Fits the residual anchors of each type to the complete agents of training scenes.
    #[must_use]
    pub fn fit<'a>(training: impl Iterator<Item = &'a Scene>, cut: &Cut, seed: u64) -> Self {
        let agents = training.flat_map(|scene| &scene.agents).filter(|agent| agent.is_complete());
        let (dt_s, horizon_len) = (cut.dt_s as f32, cut.horizon_len);
        let anchors = anchors(agents, dt_s, horizon_len, metrics::speed_cuts_mps, seed);
        Self { anchors, dt_s, horizon_len, seed }
    }

    /// The forecasts of every method for an agent, in the order of [`Method::ALL`].
    pub(crate) fn candidates(
        &self,
        scene: &Scene,
        agent: &Agent,
        forecast: &Variants,
    ) -> [Candidate; Method::ALL.len()] {
        Method::ALL.map(|method| match forecast.get(method.index()) {
            Some(variant) => variant.clone(),
            None => self.candidate(method, scene, agent),
        })
    }

    fn candidate(&self, method: Method, scene: &Scene, agent: &Agent) -> Candidate {
        let (history, dt_s, horizon_len) = (&agent.history[..], self.dt_s, self.horizon_len);
        let single = |single| Candidate { single, ..Candidate::default() };
        match method {
            Method::Anchors => {
                let anchors = self.anchors.get(&agent.agent_type);
                Candidate {
                    modes: anchors.and_then(|anchors| anchors.predict(history)).unwrap_or_default(),
                    probability: anchors.and_then(|anchors| Some(anchors.probability(history)?.to_vec())),
                    ..Candidate::default()
                }
            }
            Method::SampledVelocity => {
                let seed = self.seed ^ agent.id.rotate_left(32) ^ scene.stamp_ns as u64;
                let modes = metrics::sampled_constant_velocity(
                    history,
                    dt_s,
                    horizon_len,
                    CVM_DRAWS,
                    CVM_SIGMA_RAD,
                    &mut ChaCha8Rng::seed_from_u64(seed),
                );
                Candidate { modes: modes.unwrap_or_default(), ..Candidate::default() }
            }
            Method::ConstantVelocity => single(metrics::constant_velocity(history, dt_s, horizon_len)),
            Method::ConstantAcceleration => {
                single(metrics::constant_acceleration(history, dt_s, horizon_len))
            }
            Method::TurnRate => single(metrics::constant_turn_rate(history, dt_s, horizon_len)),
            Method::TurnRateAcceleration => {
                single(metrics::constant_turn_rate_acceleration(history, dt_s, horizon_len))
            }
            // The forecasts of the stages are variants.
            _ => Candidate::default(),
        }
    }
}

/// Fits 20 anchors on constant velocity per speed bin and type to complete agents.
pub(crate) fn anchors<'a>(
    agents: impl Iterator<Item = &'a Agent>,
    dt_s: f32,
    horizon_len: usize,
    cuts_mps: impl Fn(AgentType) -> [f32; metrics::SPEED_BINS - 1],
    seed: u64,
) -> BTreeMap<AgentType, Anchors> {
    let agents: Vec<&Agent> = agents.collect();
    let fit = |of_type: AgentType| {
        let agents = || agents.iter().filter(|agent| agent.agent_type == of_type);
        let stride = agents().count().div_ceil(ANCHOR_AGENTS).max(1);
        let windows = agents().step_by(stride);
        let windows: Vec<metrics::Window<'_>> =
            windows.map(|agent| metrics::Window { history: &agent.history, future: &agent.future }).collect();
        Anchors::fit(&windows, dt_s, horizon_len, cuts_mps(of_type), seed)
    };
    wire::AGENT_TYPES.into_iter().filter_map(|of_type| Some((of_type, fit(of_type)?))).collect()
}
