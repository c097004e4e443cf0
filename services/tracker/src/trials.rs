//! Trials of forecasts as a prior. Agents are predicted ahead with and without their forecast, as through a
//! gap. Both predictions are compared with the positions at which the agents are then detected.

use filters::Ahead;
use wire::AgentType;

/// Prediction time of a trial: half a short gap (which shows sooner that forecasts fail) and, after two
/// parts, a whole one.
pub const PART_NS: u64 = 400_000_000;
const PARTS: usize = 2;
/// Largest delay of a detection after a trial's end. An earlier detection still shows the position at the
/// end.
const LATE_MAX_NS: u64 = 200_000_000;
/// Largest number of simultaneous trials of an agent: one of each length per adopted forecast, at Δt of 0.2 s
/// and more.
const TRIALS_MAX: usize = 6;
/// Half an acceleration a, m/s². If the process model's error is below a t², all trials of a length t count
/// alike. If it is larger, the forecast's error counts relative to it.
const HALF_ACCELERATION_MPS2: f64 = 0.8;
/// Weight of the process model before any trial, by type. Vehicles and cyclists move nearly as the process
/// model does, so their forecasts must earn their weight. Pedestrians do not.
const EXPECTED: [f64; 3] = [0.9, 0.9, 0.05];
/// Weights, in units of [`Shown::apart`]: of the expectation relative to trials of the type, and of the type
/// relative to the agent's own trials.
const TYPE_PRIOR: f64 = 1.0;
const AGENT_PRIOR: f64 = 0.5;
/// Share of earlier trials that remains when another trial matures: for the type, and for the agent. For the
/// agent mainly the last second counts.
const TYPE_KEEPS: f64 = 0.995;
const AGENT_KEEPS: f64 = 0.6;
/// Largest weight of the process model. The forecast keeps some weight, so that trials continue.
const WEIGHT_MAX: f64 = 0.98;

/// A prediction that will be compared with a detection.
#[derive(Clone, Copy, Debug)]
struct Trial {
    due_ns: i64,
    ahead_s: f64,
    ahead: Ahead,
}

/// The trials of an agent and their results.
#[derive(Clone, Copy, Debug, Default)]
pub struct Trials {
    open: [Option<Trial>; TRIALS_MAX],
    next: usize,
    shown: Shown,
}

/// Results of trials, as sums whose earlier terms fade.
///
/// e is the error of the forecast and k the error of the process model. The blend α k + (1 − α) e has the
/// smallest weighted square error at
///
/// ```text
/// α = Σ w e·(e − k) / Σ w |e − k|²      w = 1 / ((a t²)² + |k|²)
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Shown {
    for_kinematic: f64,
    apart: f64,
}

impl Shown {
    /// The result of a trial of this length, from the errors of forecast and process model.
    fn by(ahead_s: f64, learned_m: [f64; 2], kinematic_m: [f64; 2]) -> Self {
        let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
        let apart_m = [0, 1].map(|axis| learned_m[axis] - kinematic_m[axis]);
        let weight =
            1.0 / ((HALF_ACCELERATION_MPS2 * ahead_s * ahead_s).powi(2) + dot(kinematic_m, kinematic_m));
        Self { for_kinematic: weight * dot(learned_m, apart_m), apart: weight * dot(apart_m, apart_m) }
    }

    /// Adds the result of another trial of the type.
    pub fn add_of_type(&mut self, other: &Self) {
        self.add(other, TYPE_KEEPS);
    }

    fn add(&mut self, other: &Self, keeps: f64) {
        self.apart = keeps * self.apart + other.apart;
        // Clamped, because a blend cannot extrapolate beyond the two.
        self.for_kinematic = (keeps * self.for_kinematic + other.for_kinematic).clamp(0.0, self.apart);
    }

    /// The process model's weight with the least square error. `expected` counts with the weight `prior`.
    fn kinematic_weight(&self, expected: f64, prior: f64) -> f64 {
        (prior * expected + self.for_kinematic) / (prior + self.apart)
    }
}

impl Trials {
    /// Begins a trial of each length at `stamp_ns`. They replace the oldest trials.
    pub fn begin(&mut self, stamp_ns: i64, ahead: [Ahead; PARTS]) {
        let mut ahead_ns = 0;
        for ahead in ahead {
            ahead_ns += PART_NS;
            let (due_ns, ahead_s) = (stamp_ns.saturating_add_unsigned(ahead_ns), ahead_ns as f64 / 1e9);
            self.open[self.next] = Some(Trial { due_ns, ahead_s, ahead });
            self.next = (self.next + 1) % TRIALS_MAX;
        }
    }

    /// Ends the due trials by a detection at `stamp_ns` of an agent with this velocity. Returns the result of
    /// each.
    pub fn mature(
        &mut self,
        stamp_ns: i64,
        position_m: [f64; 2],
        velocity_mps: [f64; 2],
    ) -> impl Iterator<Item = Shown> {
        let Self { open, shown, .. } = self;
        open.iter_mut().filter_map(move |open| {
            let Trial { due_ns, ahead_s, ahead } = open.take_if(|trial| trial.due_ns <= stamp_ns)?;
            let late_ns = stamp_ns.abs_diff(due_ns);
            if late_ns > LATE_MAX_NS {
                return None;
            }
            let late_s = late_ns as f64 / 1e9;
            let error_m = |of_m: [f64; 2]| {
                [0, 1].map(|axis| of_m[axis] - (position_m[axis] - late_s * velocity_mps[axis]))
            };
            let of_trial = Shown::by(ahead_s, error_m(ahead.learned_m), error_m(ahead.kinematic_m));
            shown.add(&of_trial, AGENT_KEEPS);
            Some(of_trial)
        })
    }

    /// Weight of the process model relative to the agent's forecasts, by the agent's own trials and the
    /// trials of its type. It is at least `least`.
    pub fn kinematic_weight(&self, of_type: &Shown, agent_type: AgentType, least: f64) -> f64 {
        let of_type = of_type.kinematic_weight(EXPECTED[agent_type.index()], TYPE_PRIOR);
        self.shown.kinematic_weight(of_type, AGENT_PRIOR).clamp(least, WEIGHT_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_NS: i64 = 80_000_000;

    /// Trials of an agent that moves along x, one every 0.4 s, and their results. The process model's error
    /// is 1 m, and the forecast's error is this share of it.
    fn trials(share: f64, trial_count: i64) -> (Trials, Vec<Shown>) {
        let (mut trials, mut all) = (Trials::default(), Vec::new());
        let at_m = |stamp_ns: i64| [stamp_ns as f64 * 5e-9, 0.0];
        for tick in 0..5 * trial_count + 10 {
            let stamp_ns = tick * TICK_NS;
            all.extend(trials.mature(stamp_ns, at_m(stamp_ns), [5.0, 0.0]));
            if tick % 5 == 0 && tick < 5 * trial_count {
                let ahead = |part: i64| {
                    let [x, y] = at_m(stamp_ns + part * PART_NS as i64);
                    Ahead { learned_m: [x, y + share], kinematic_m: [x, y + 1.0] }
                };
                trials.begin(stamp_ns, [1, 2].map(ahead));
            }
        }
        (trials, all)
    }

    #[test]
    fn every_trial_matures_once() {
        assert_eq!(trials(0.5, 7).1.len(), PARTS * 7);
    }

    fn of_type(share: f64) -> Shown {
        let mut of_type = Shown::default();
        trials(share, 500).1.iter().for_each(|shown| of_type.add_of_type(shown));
        of_type
    }

    #[test]
    fn the_blend_has_the_least_squared_error() {
        // Errors of −1 m and 1 m cancel at equal weights. If both have the same sign, the nearer one gets the
        // whole weight.
        for (share, expected) in [(-1.0, 0.5), (-3.0, 0.75), (0.5, 0.0), (2.0, 1.0)] {
            let found = of_type(share).kinematic_weight(EXPECTED[0], 1e-9);
            assert!((found - expected).abs() < 1e-3, "{share}: {found}");
        }
    }

    #[test]
    fn the_weight_keeps_to_its_limits() {
        let weight = |share| trials(share, 50).0.kinematic_weight(&of_type(share), AgentType::Vehicle, 0.05);
        assert_eq!((weight(0.5), weight(3.0)), (0.05, WEIGHT_MAX));
        let at_first = Trials::default().kinematic_weight(&Shown::default(), AgentType::Vehicle, 0.05);
        assert!((at_first - EXPECTED[0]).abs() < 1e-12, "{at_first}");
    }

    #[test]
    fn a_late_detection_is_taken_back_by_the_velocity_and_a_later_one_shows_nothing() {
        let shown = |late_ns: i64| {
            let mut trials = Trials::default();
            let ahead = |x: f64| Ahead { learned_m: [x, 0.0], kinematic_m: [x, 1.0] };
            trials.begin(0, [2.0, 4.0].map(ahead));
            let stamp_ns = 2 * PART_NS as i64 + late_ns;
            let x_m = stamp_ns as f64 * 5e-9;
            trials.mature(stamp_ns, [x_m, 0.0], [5.0, 0.0]).next()
        };
        let (in_time, late) = (shown(0).expect("due"), shown(TICK_NS).expect("due"));
        assert!((in_time.for_kinematic - late.for_kinematic).abs() < 1e-9 && in_time.apart > 0.0);
        assert!(shown(-1).is_none() && shown(3 * TICK_NS).is_none());
    }
}
