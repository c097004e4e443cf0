//! Evidence on the experts in the sampler: what the network's forecasts have been worth, and the others'.

use evidence::{Agent, EXPERTS, Evidence, Mixture, MotionNow, Paths, Prior};
use kinematics::MotionModel;
use metrics::HighestDensity;
use retrieval::{ControlChange, Residuals};
use scene::{AgentType, State};
use wire::{Expert, Forecast, HORIZON_MAX, MODES_MAX, Quality, Track};

/// History steps over which turn rate and acceleration are taken, where there are as many.
const RATE_STEPS: usize = 2;
/// Seed of the levels; every forecast has the same draws.
const SEED: u64 = 1;
/// Least and largest factor of the spread of the modes; what is beyond changes covariances alone.
const SPREAD: [f32; 2] = [0.1, 1.6];
/// No agent is farther from where it would be without control than this acceleration takes it.
const REACH_MPS2: f32 = 10.0;
/// Deviation of a position that no physics bounds: that of the present one.
const REACH_M: f32 = 2.0;
/// Radius of a region of 90 % in standard deviations.
const RADIUS: f32 = 2.145_966;

/// The evidence of a run, and scratch memory.
pub(crate) struct Experts {
    evidence: Evidence,
    levels: HighestDensity,
    horizon_len: usize,
}

/// What the evidence makes of one agent.
pub(crate) struct Blended {
    agent: Agent,
    paths: Paths,
    weights: [[f32; EXPERTS]; HORIZON_MAX],
    /// The single best forecast.
    pub(crate) best_m: [[f32; 2]; HORIZON_MAX],
    /// The change of controls that leads from the network's best forecast there.
    pub(crate) shift: ControlChange,
    /// How the modes spread, and how wide their covariances are.
    pub(crate) spread: Spread,
}

/// How a forecast widens.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spread {
    /// Factor of the modes' deviation from the best forecast, and of their controls' standard deviations.
    pub(crate) modes: f32,
    /// Further factor of the standard deviations of the positions, step by step.
    pub(crate) deviations: [f32; HORIZON_MAX],
    /// Largest variance of a position, step by step, m².
    pub(crate) variance_max_m2: [f32; HORIZON_MAX],
}

impl Default for Spread {
    fn default() -> Self {
        Self { modes: 1.0, deviations: [1.0; HORIZON_MAX], variance_max_m2: [f32::INFINITY; HORIZON_MAX] }
    }
}

impl Spread {
    /// The spread by which regions widen by these factors.
    fn of(widths: &[f32; HORIZON_MAX], horizon_len: usize, dt_s: f32) -> Self {
        let mean = widths[..horizon_len].iter().map(|width| width.ln()).sum::<f32>() / horizon_len as f32;
        let modes = mean.exp().clamp(SPREAD[0], SPREAD[1]);
        let variance_max_m2 = std::array::from_fn(|step| {
            let time_s = (step + 1) as f32 * dt_s;
            ((REACH_M + 0.5 * REACH_MPS2 * time_s * time_s) / RADIUS).powi(2)
        });
        Self { modes, deviations: widths.map(|width| width / modes), variance_max_m2 }
    }

    /// A covariance of a step as (xx, xy, yy), widened, within physical limits.
    pub(crate) fn of_covariance(&self, step: usize, covariance: [f32; 3]) -> [f32; 3] {
        let factor = self.deviations[step] * self.deviations[step];
        let [xx, xy, yy] = covariance.map(|entry| factor * entry);
        let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let most = self.variance_max_m2[step];
        if largest > most { [xx, xy, yy].map(|entry| entry * (most / largest)) } else { [xx, xy, yy] }
    }
}

impl Experts {
    pub(crate) fn new(horizon_len: usize, step_ns: u64) -> Self {
        let evidence = Evidence::new(horizon_len, step_ns, &Prior::shipped());
        Self { evidence, levels: HighestDensity::with_room(MODES_MAX), horizon_len }
    }

    pub(crate) const fn evidence(&self) -> &Evidence {
        &self.evidence
    }

    pub(crate) fn end_session(&mut self) {
        self.evidence.end_session();
    }

    /// Learns from the positions of agents at a time.
    pub(crate) fn observe(&mut self, stamp_ns: i64, agents: impl IntoIterator<Item = (u64, [f32; 2])>) {
        let Self { evidence, levels, .. } = self;
        evidence.observe_with(stamp_ns, agents, |matured| {
            let (means_m, covariances_m2) = (matured.means_m, matured.covariances_m2);
            levels.level(means_m, covariances_m2, matured.probability, matured.truth_m, SEED)
        });
    }

    /// Blends the experts' paths of an agent.
    pub(crate) fn blend(
        &self,
        (track, agent_type): (&Track, AgentType),
        history: &[Option<State>],
        model: &MotionModel,
        (network, base): (impl Iterator<Item = [f32; 2]>, impl Iterator<Item = [f32; 2]>),
        dt_s: f32,
    ) -> Blended {
        let len = self.horizon_len;
        let now = motion_now(track, history, dt_s);
        let mut paths = Paths { velocity: [[0.0; 2]; HORIZON_MAX], experts: [[[0.0; 2]; HORIZON_MAX]; EXPERTS] };
        let [by_network, by_base, by_turn, by_acceleration] = &mut paths.experts;
        now.steady(dt_s, &mut paths.velocity[..len]);
        now.turning(dt_s, &mut by_turn[..len]);
        now.accelerating(dt_s, &mut by_acceleration[..len]);
        model.positions(network, &mut by_network[..len]);
        model.positions(base, &mut by_base[..len]);

        let agent = Agent { id: track.id, agent_type, speed_mps: now.speed_mps() };
        let weights = self.evidence.weights(agent_type, agent.speed_mps);
        let mut best_m = [[0.0; 2]; HORIZON_MAX];
        self.evidence.blend(&weights, &paths, &mut best_m[..len]);
        let network_m = &paths.experts[0][..len];
        let shift = Residuals::between(model.kind(), now.position_m, network_m, &best_m[..len], dt_s)
            .control_change(model);
        let widths = self.evidence.widths(agent_type, agent.speed_mps);
        let spread = Spread::of(&widths, len, dt_s);
        Blended { agent, paths, weights, best_m, shift, spread }
    }

    /// Writes into a forecast who made it, and keeps it until it matures.
    pub(crate) fn publish(&mut self, stamp_ns: i64, blended: &Blended, out: &mut Forecast) {
        out.best[..self.horizon_len].copy_from_slice(&blended.best_m[..self.horizon_len]);
        out.expert_weights = self.evidence.slots(&blended.weights);
        if out.expert_weights[Expert::ConstantVelocity as usize] > 0.5 {
            out.quality = Quality::Kinematic as u32;
            (out.cause, out.causes) = (wire::Cause::Outdone as u32, wire::Cause::Outdone.bit());
        }
        let widths = &std::array::from_fn(|step| blended.spread.modes * blended.spread.deviations[step]);
        let mixture = Mixture {
            probability: &out.probability[..out.modes_len as usize],
            modes_m: &out.modes,
            covariances_m2: &out.mode_covariance,
            widths,
        };
        self.evidence.store(stamp_ns, &blended.agent, &blended.paths, Some(mixture));
    }
}

/// The present motion of a track, its rates from the newest steps of its history.
fn motion_now(track: &Track, history: &[Option<State>], dt_s: f32) -> MotionNow {
    let before = (1..=RATE_STEPS).rev().find_map(|back| {
        let state = (*history.len().checked_sub(back + 1).and_then(|step| history.get(step))?)?;
        Some((state.velocity_mps, back as f32 * dt_s))
    });
    MotionNow::since([track.x_m, track.y_m], [track.vx_mps, track.vy_mps], before)
}
