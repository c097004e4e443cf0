//! Evidence on the experts in the sampler: what the network's forecasts have been worth, and the others'.

use evidence::{Agent, EXPERTS, Evidence, Fan, Mixture, MotionNow, Paths, Prior};
use kinematics::{Moments, MotionModel};
use metrics::HighestDensity;
use retrieval::{ControlChange, ControlChanges, ForecastControls, Residuals};
use scene::{AgentType, State};
use wire::{Expert, Forecast, HORIZON_MAX, MODES_MAX, Quality, Track};

/// History steps over which turn rate and acceleration are taken, where there are as many.
const RATE_STEPS: usize = 2;
/// Seed of the levels; every forecast has the same draws.
const SEED: u64 = 1;
/// Least and largest factor of the standard deviations.
const FACTORS: [f32; 2] = [0.25, 4.0];
/// Deviation of a mode's position as a share of how far it is from the best forecast, beside its own: the modes
/// stand for what lies between them, and that is wide where they are far apart.
const BETWEEN: f32 = 0.1;
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
    /// How wide the modes are.
    pub(crate) spread: Spread,
    fan: Fan,
    /// The network's modes, once the forecast has been changed.
    network_m: [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
}

/// How wide the modes of a forecast are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spread {
    /// Factor of the standard deviations of the positions, step by step.
    factors: [f32; HORIZON_MAX],
    /// Largest variance of a position, step by step, m².
    variance_max_m2: [f32; HORIZON_MAX],
    /// Modes of the fan, a bit each, and their own covariances.
    fan: (u32, [[f32; 3]; HORIZON_MAX]),
    /// The best forecast, step by step, if modes are wider the farther they are from it.
    best_m: Option<[[f32; 2]; HORIZON_MAX]>,
}

impl Default for Spread {
    fn default() -> Self {
        Self {
            factors: [1.0; HORIZON_MAX],
            variance_max_m2: [f32::INFINITY; HORIZON_MAX],
            fan: (0, [[0.0; 3]; HORIZON_MAX]),
            best_m: None,
        }
    }
}

impl Spread {
    /// The spread by which regions widen by these factors.
    fn of(widths: &[f32; HORIZON_MAX], fan: &Fan, best_m: [[f32; 2]; HORIZON_MAX], dt_s: f32) -> Self {
        let variance_max_m2 = std::array::from_fn(|step| {
            let time_s = (step + 1) as f32 * dt_s;
            ((REACH_M + 0.5 * REACH_MPS2 * time_s * time_s) / RADIUS).powi(2)
        });
        let factors = widths.map(|width| width.clamp(FACTORS[0], FACTORS[1]));
        let covariances_m2 = std::array::from_fn(|step| fan.covariance_m2(step));
        Self { factors, variance_max_m2, fan: (0, covariances_m2), best_m: Some(best_m) }
    }

    /// Whether modes and regions keep to what physics allows: those of a forecast with evidence do.
    pub(crate) const fn is_limited(&self) -> bool {
        self.variance_max_m2[0].is_finite()
    }

    /// Whether a mode is one of the fan.
    pub(crate) const fn is_fan(&self, mode: usize) -> bool {
        self.fan.0 & (1 << mode) != 0
    }

    /// The covariance of a mode at a step as (xx, xy, yy), widened, within physical limits.
    pub(crate) fn of_covariance(&self, (mode, step): (usize, usize), moments: &Moments) -> [f32; 3] {
        let covariance = if self.is_fan(mode) { self.fan.1[step] } else { moments.covariance };
        let factor = self.factors[step] * self.factors[step];
        let [xx, xy, yy] = covariance.map(|entry| factor * entry);
        let between = self.best_m.map_or(0.0, |best_m| {
            let [x, y] = [0, 1].map(|axis| BETWEEN * (moments.mean[axis] - best_m[step][axis]));
            x * x + y * y
        });
        let (xx, yy) = (xx + between, yy + between);
        let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let most = self.variance_max_m2[step];
        if largest > most { [xx, xy, yy].map(|entry| entry * (most / largest)) } else { [xx, xy, yy] }
    }
}

impl Experts {
    pub(crate) fn new(horizon_len: usize, step_ns: u64, prior: &Prior) -> Self {
        let evidence = Evidence::new(horizon_len, step_ns, prior);
        Self { evidence, levels: HighestDensity::with_room(MODES_MAX), horizon_len }
    }

    pub(crate) const fn evidence(&self) -> &Evidence {
        &self.evidence
    }

    pub(crate) const fn evidence_mut(&mut self) -> &mut Evidence {
        &mut self.evidence
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
        let mut paths =
            Paths { velocity: [[0.0; 2]; HORIZON_MAX], experts: [[[0.0; 2]; HORIZON_MAX]; EXPERTS] };
        let [by_network, by_base, by_turn, by_acceleration] = &mut paths.experts;
        now.steady(dt_s, &mut paths.velocity[..len]);
        now.turning(dt_s, &mut by_turn[..len]);
        now.accelerating(dt_s, &mut by_acceleration[..len]);
        model.positions(network, &mut by_network[..len]);
        model.positions(base, &mut by_base[..len]);

        let (speed_mps, course) = (now.speed_mps(), now.course(track.heading_rad));
        let agent = Agent { id: track.id, agent_type, speed_mps, course };
        let weights = self.evidence.weights(agent_type, agent.speed_mps);
        let mut best_m = [[0.0; 2]; HORIZON_MAX];
        self.evidence.blend(&weights, &paths, &mut best_m[..len]);
        let network_m = &paths.experts[0][..len];
        let shift = Residuals::between(model.kind(), now.position_m, network_m, &best_m[..len], dt_s)
            .control_change(model);
        let widths = self.evidence.widths(agent_type, agent.speed_mps);
        let fan = self.evidence.fan(&agent, &paths.velocity, &best_m);
        let spread = Spread::of(&widths, &fan, best_m, dt_s);
        let network_m = [[[0.0; 2]; HORIZON_MAX]; MODES_MAX];
        Blended { agent, paths, weights, best_m, shift, spread, fan, network_m }
    }

    /// Moves the best forecast to the blend, and replaces modes that others stand for by modes of the fan.
    pub(crate) fn change<M: AsRef<[wire::ControlGaussian]>>(
        &self,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        blended: &mut Blended,
        changes: &mut ControlChanges,
    ) {
        changes.shift_best(&blended.shift);
        let Blended { agent, fan, network_m, spread, .. } = blended;
        let (len, modes_len) = (self.horizon_len, controls.modes.len());
        for (mode, path) in network_m[..modes_len].iter_mut().enumerate() {
            model.positions(changes.mode(mode, controls).map(|control| control.mean), &mut path[..len]);
        }
        let network = (&network_m[..modes_len], changes.probability());
        let choice = self.evidence.choose(agent, network, fan);
        let mut of_fan = (0..modes_len).filter_map(|number| Some((number, choice.of_fan(number)?)));
        for mode in 0..modes_len {
            if let Some(probability) = choice.of_network(mode) {
                changes.set_probability(mode, probability);
                continue;
            }
            let Some((number, probability)) = of_fan.next() else { break };
            let mut path = [[0.0; 2]; HORIZON_MAX];
            for (step, path) in path[..len].iter_mut().enumerate() {
                *path = fan.position_m(number, step);
            }
            let mut means = ControlChange::default();
            model.follow(&path[..len], &mut means);
            changes.replace(mode, &means, controls, probability);
            spread.fan.0 |= 1 << mode;
        }
    }

    /// Writes into a forecast who made it.
    pub(crate) fn sign(&self, blended: &Blended, out: &mut Forecast) {
        out.best[..self.horizon_len].copy_from_slice(&blended.best_m[..self.horizon_len]);
        out.expert_weights = self.evidence.slots(&blended.weights);
        if out.expert_weights[Expert::ConstantVelocity as usize] > 0.5 {
            out.quality = Quality::Kinematic as u32;
            (out.cause, out.causes) = (wire::Cause::Outdone as u32, wire::Cause::Outdone.bit());
        }
        let modes_len = out.modes_len as usize;
        for mode in (0..modes_len).filter(|&mode| blended.spread.is_fan(mode)) {
            out.mode_expert[mode] = Expert::Fan as u8;
        }
    }

    /// Keeps a forecast until it matures.
    pub(crate) fn store(&mut self, stamp_ns: i64, blended: &Blended, forecast: &Forecast) {
        let modes_len = forecast.modes_len as usize;
        let mixture = Mixture {
            probability: &forecast.probability[..modes_len],
            modes_m: &forecast.modes,
            covariances_m2: &forecast.mode_covariance,
            widths: &blended.spread.factors,
            network_m: &blended.network_m[..modes_len],
            fan: &blended.fan,
        };
        self.evidence.store(stamp_ns, &blended.agent, (&blended.paths, &blended.best_m), Some(mixture));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_far_from_the_best_forecast_stay_wide_where_regions_narrow() {
        let agent = Agent { id: 1, agent_type: AgentType::Vehicle, speed_mps: 0.0, course: [1.0, 0.0] };
        let best_m = [[3.0, 4.0]; HORIZON_MAX];
        let evidence = Evidence::new(1, 400_000_000, &Prior::default());
        let fan = evidence.fan(&agent, &best_m, &best_m);
        let spread = Spread::of(&[0.1; HORIZON_MAX], &fan, best_m, 0.4);
        let of = |mean| spread.of_covariance((0, 11), &Moments { mean, covariance: [0.16, 0.0, 0.16] });
        assert_eq!(of([3.0, 4.0]), [0.01, 0.0, 0.01]);
        let [xx, xy, yy] = of([13.0, 4.0]);
        assert!((xx - 1.01).abs() < 1e-5 && xx == yy && xy == 0.0, "{xx} {xy} {yy}");
        // No mode is wider than physics lets the agent be.
        let most = spread.variance_max_m2[11];
        let [xx, ..] = of([1e6, 4.0]);
        assert!((xx - most).abs() < 1e-3 * most, "{xx} {most}");
        let as_it_is = Spread::default()
            .of_covariance((0, 11), &Moments { mean: [13.0, 4.0], covariance: [0.16, 0.0, 0.16] });
        assert_eq!(as_it_is, [0.16, 0.0, 0.16]);
    }
}
