//! Evidence on the experts in the sampler: how accurate the network's forecasts and those of the other
//! experts have been.

use evidence::{
    Agent, EXPERTS, Evidence, Fan, Line, Mixture, MotionNow, Observed, Paths, Prior, RoadUser, Traffic,
};
use kinematics::MotionModel;
use lanes::LaneLine;
use regions::HighestDensity;
use retrieval::{ControlChange, ControlChanges, ForecastControls};
use scene::{AgentType, track_history};
use wire::{Expert, Forecast, HORIZON_MAX, MODES_MAX, Quality, Track};

use crate::spread::Spread;

/// Number of history steps, if available, from which turn rate and acceleration are computed.
const RATE_STEPS: usize = 2;
/// The same if the positions have noise from [`NOISY_M`] on: rates over a longer time contain less of it.
const RATE_STEPS_NOISY: usize = 4;
const NOISY_M: f32 = 0.05;
/// Number of history steps, if available, of the mean velocity.
const MEAN_STEPS: usize = 4;
/// Mean distance between a lane and the decaying turn at which the lane's share falls to exp(−½).
const OFF_LANE_M: f32 = 3.0;
/// Seed of the levels; every forecast has the same draws.
const SEED: u64 = 1;

/// The evidence of a run, and scratch memory.
pub(crate) struct Experts {
    evidence: Evidence,
    levels: HighestDensity,
    horizon_len: usize,
}

/// The results of the evidence for one agent.
pub(crate) struct Blended {
    agent: Agent,
    paths: Paths,
    weights: [[f32; EXPERTS]; HORIZON_MAX],
    /// The single best forecast.
    pub(crate) best_m: [[f32; 2]; HORIZON_MAX],
    /// The widths of the modes.
    pub(crate) spread: Spread,
    fan: Fan,
    /// Bit set of the modes that come from the fan.
    fan_modes: u32,
    /// The network's modes, computed by [`Experts::change`].
    network_m: [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
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
    pub(crate) fn observe(&mut self, stamp_ns: i64, agents: impl IntoIterator<Item = (u64, Observed)>) {
        let Self { evidence, levels, .. } = self;
        evidence.observe_with(stamp_ns, agents, |matured| {
            let (means_m, covariances_m2) = (matured.means_m, matured.covariances_m2);
            levels.level(means_m, covariances_m2, matured.probability, matured.truth_m, SEED)
        });
    }

    /// Blends the experts' paths of an agent.
    pub(crate) fn blend<'l>(
        &self,
        user: &RoadUser,
        agent_type: AgentType,
        traffic: &Traffic,
        lane: impl FnOnce(&[[f32; 2]]) -> Option<LaneLine<'l>>,
        model: &MotionModel,
        (network, base): (impl Iterator<Item = [f32; 2]>, impl Iterator<Item = [f32; 2]>),
        dt_s: f32,
    ) -> Blended {
        let len = self.horizon_len;
        let now = &user.motion;
        let mut paths =
            Paths { velocity: [[0.0; 2]; HORIZON_MAX], experts: [[[0.0; 2]; HORIZON_MAX]; EXPERTS] };
        let [by_network, by_base, by_turn, by_acceleration, by_following, by_lane] = &mut paths.experts;
        now.steady(dt_s, &mut paths.velocity[..len]);
        now.turning(dt_s, &mut by_turn[..len]);
        now.accelerating(dt_s, &mut by_acceleration[..len]);
        if agent_type == AgentType::Pedestrian {
            // It follows neither vehicles nor lanes. It may stop or keep its way.
            by_following[..len].fill(now.position_m);
            now.by_mean_velocity(dt_s, &mut by_lane[..len]);
        } else {
            let leader = traffic.leader_on_turn(user, len as f32 * dt_s);
            now.following(dt_s, leader.as_ref(), &mut by_following[..len]);
            *by_lane = *by_following;
            if let Some(lane) = lane(&by_turn[..len]) {
                along_lane(user, traffic, &lane, dt_s, &mut by_lane[..len]);
            }
        }
        model.positions(network, &mut by_network[..len]);
        model.positions(base, &mut by_base[..len]);

        let (speed_mps, course) = (now.speed_mps(), now.course(user.heading_rad));
        let agent = Agent { id: user.id, agent_type, speed_mps, course };
        let weights = self.evidence.weights(agent_type, agent.speed_mps);
        let mut best_m = [[0.0; 2]; HORIZON_MAX];
        self.evidence.blend(&weights, &paths, &mut best_m[..len]);
        let widths = self.evidence.widths(agent_type, agent.speed_mps);
        let fan = self.evidence.fan(&agent, &paths.velocity, &best_m);
        let spread = Spread::of(&widths, &fan, dt_s);
        let network_m = [[[0.0; 2]; HORIZON_MAX]; MODES_MAX];
        Blended { agent, paths, weights, best_m, spread, fan, fan_modes: 0, network_m }
    }

    /// Replaces the modes that the evidence does not select by modes of the fan.
    pub(crate) fn change<M: AsRef<[wire::ControlGaussian]>>(
        &self,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        blended: &mut Blended,
        changes: &mut ControlChanges,
    ) {
        let Blended { agent, fan, network_m, fan_modes, .. } = blended;
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
            *fan_modes |= 1 << mode;
        }
    }

    /// Writes the single best forecast and the weights of the experts into a forecast, and marks the modes of
    /// the fan. The forecast is marked as kinematic if constant velocity has most of the weight.
    pub(crate) fn sign(&self, blended: &Blended, out: &mut Forecast) {
        out.best[..self.horizon_len].copy_from_slice(&blended.best_m[..self.horizon_len]);
        out.expert_weights = self.evidence.slots(&blended.weights);
        if out.expert_weights[Expert::ConstantVelocity as usize] > 0.5 {
            out.quality = Quality::Kinematic as u32;
            (out.cause, out.causes) = (wire::Cause::Outdone as u32, wire::Cause::Outdone.bit());
        }
        let modes_len = out.modes_len as usize;
        for mode in (0..modes_len).filter(|&mode| blended.fan_modes & (1 << mode) != 0) {
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

/// Moves a path onto the lane, at the speed that lane and leader permit.
fn along_lane(user: &RoadUser, traffic: &Traffic, lane: &LaneLine<'_>, dt_s: f32, path: &mut [[f32; 2]]) {
    let (points_m, along_m) = lane.points();
    let leader = traffic.leader(user, Line { points_m, along_m });
    let (mut gone_m, mut on_lane) = ([0.0; HORIZON_MAX], [[0.0; 2]; HORIZON_MAX]);
    let (gone_m, on_lane) = (&mut gone_m[..path.len()], &mut on_lane[..path.len()]);
    let speeds_mps = lane.speeds_mps();
    let most_mps = |gone_m: f32| speeds_mps[along_m.partition_point(|m| *m <= gone_m).saturating_sub(1)];
    user.motion.progress(dt_s, leader.as_ref(), most_mps, gone_m);
    lane.at(gone_m, on_lane);
    let trust = (-0.5 * (lane.apart_m / OFF_LANE_M).powi(2)).exp();
    for (point, on_lane) in path.iter_mut().zip(on_lane) {
        *point = [0, 1].map(|axis| point[axis] + trust * (on_lane[axis] - point[axis]));
    }
}

/// A track as others see it on the road. The newest steps of its history determine its rates.
pub(crate) fn road_user(track: &Track, history_len: usize, dt_s: f32) -> RoadUser {
    let history = &track_history(track)[..history_len];
    let steps = if track.noise_m >= NOISY_M { RATE_STEPS_NOISY } else { RATE_STEPS };
    let oldest = |steps: usize| {
        (1..=steps).rev().find_map(|back| {
            let state = (*history.len().checked_sub(back + 1).and_then(|step| history.get(step))?)?;
            Some((state, back as f32 * dt_s))
        })
    };
    let before = oldest(steps).map(|(state, since_s)| (state.velocity_mps, since_s));
    let mut motion = MotionNow::since([track.x_m, track.y_m], [track.vx_mps, track.vy_mps], before);
    if let Some((state, since_s)) = oldest(MEAN_STEPS) {
        let gone_m = [0, 1].map(|axis| motion.position_m[axis] - state.position_m[axis]);
        motion.mean_velocity_mps = gone_m.map(|gone_m| gone_m / since_s);
    }
    let usual_m = track.agent_type().map_or([0.5; 2], AgentType::usual_size_m);
    let own_m = [track.length_m, track.width_m];
    let size_m = [0, 1].map(|side| if own_m[side] > 0.0 { own_m[side] } else { usual_m[side] });
    RoadUser { id: track.id, motion, heading_rad: track.heading_rad, size_m }
}
