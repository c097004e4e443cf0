//! Conflicts: pairs of agents that come too close within the horizon, and how well forecasts foretell them.
//!
//! An outline is three circles along the agent, or one for a pedestrian. The *gap* of a pair is the smallest
//! distance between their outlines at a common step. A pair has a *conflict* if its gap falls below
//! [`CONFLICT_M`].

use scene::AgentType;
use wire::{Forecast, HORIZON_MAX};

/// A smaller gap is a conflict.
const CONFLICT_M: f32 = 0.5;
/// Width of the logistic function that softens this bound for modes.
const SOFT_M: f32 = 0.5;
/// Pairs that are closer already are left out.
const APART_MIN_M: f32 = 1.0;
/// Pairs that are farther apart are left out.
const APART_MAX_M: f32 = 60.0;
/// Pairs of which nobody is faster are left out.
const MOVES_MPS: f32 = 0.5;
/// Time between two looks at all pairs.
pub(crate) const EVERY_NS: i64 = 800_000_000;
/// Radius of a pedestrian.
const PEDESTRIAN_M: f32 = 0.3;
/// Below this distance of a step, an agent keeps its direction.
const STEP_MIN_M: f32 = 0.1;
/// Recall at which false alarms are counted.
pub(crate) const RECALL: f64 = 0.6;

/// What foretells conflicts.
pub(crate) const FORETELLERS: [&str; 3] = ["constant velocity", "single best", "modes"];

/// A pair of agents at a time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    /// Time until the conflict, s; `None` without one.
    pub(crate) conflict_s: Option<f32>,
    /// The score by each of [`FORETELLERS`]: larger means that a conflict is more likely.
    pub(crate) scores: [f32; FORETELLERS.len()],
}

/// The outlines of an agent along a path.
#[derive(Clone, Copy, Debug)]
struct Outline {
    len: usize,
    circle_count: usize,
    radius_m: f32,
    centres_m: [[[f32; 2]; 3]; HORIZON_MAX],
}

/// An agent whose future is known.
pub(crate) struct Known<'a> {
    pub(crate) forecast: &'a Forecast,
    pub(crate) agent_type: AgentType,
    /// Its position at each step.
    pub(crate) truth_m: Vec<[f32; 2]>,
}

/// All pairs of a tick.
pub(crate) fn pairs(agents: &[Known<'_>], dt_s: f32, out: &mut Vec<Pair>) {
    let drawn: Vec<Drawn> = agents.iter().map(|agent| Drawn::new(agent, dt_s)).collect();
    for (number, (a, drawn_a)) in agents.iter().zip(&drawn).enumerate() {
        for (b, drawn_b) in agents[..number].iter().zip(&drawn) {
            let [x, y] = [a.forecast.x_m - b.forecast.x_m, a.forecast.y_m - b.forecast.y_m];
            let moves = [a, b].iter().any(|of| of.forecast.vx_mps.hypot(of.forecast.vy_mps) > MOVES_MPS);
            if !moves || x.hypot(y) > APART_MAX_M || drawn_a.now.gap(&drawn_b.now).0 < APART_MIN_M {
                continue;
            }
            let (truth_m, step) = drawn_a.truth.gap(&drawn_b.truth);
            let single = |a: &Outline, b: &Outline| -a.gap(b).0;
            out.push(Pair {
                conflict_s: (truth_m < CONFLICT_M).then_some((step + 1) as f32 * dt_s),
                scores: [
                    single(&drawn_a.steady, &drawn_b.steady),
                    single(&drawn_a.best, &drawn_b.best),
                    of_modes(drawn_a, drawn_b),
                ],
            });
        }
    }
}

/// The probability of a conflict by independent modes.
fn of_modes(a: &Drawn, b: &Drawn) -> f32 {
    let mut sum = 0.0;
    for (mode_a, p_a) in &a.modes {
        for (mode_b, p_b) in &b.modes {
            sum += p_a * p_b / (1.0 + ((mode_a.gap(mode_b).0 - CONFLICT_M) / SOFT_M).exp());
        }
    }
    sum
}

/// The outlines of an agent.
struct Drawn {
    now: Outline,
    truth: Outline,
    steady: Outline,
    best: Outline,
    modes: Vec<(Outline, f32)>,
}

impl Drawn {
    fn new(agent: &Known<'_>, dt_s: f32) -> Self {
        let Known { forecast, agent_type, truth_m } = agent;
        let len = truth_m.len();
        let start_m = [forecast.x_m, forecast.y_m];
        let velocity_mps = [forecast.vx_mps, forecast.vy_mps];
        let steady: Vec<[f32; 2]> = (1..=len)
            .map(|step| [0, 1].map(|axis| start_m[axis] + step as f32 * dt_s * velocity_mps[axis]))
            .collect();
        let size_m = [forecast.length_m, forecast.width_m];
        let outline =
            |path_m: &[[f32; 2]]| Outline::new(*agent_type, size_m, start_m, forecast.heading_rad, path_m);
        let modes_len = forecast.modes_len as usize;
        let modes = forecast.modes[..modes_len].iter().zip(&forecast.probability);
        Self {
            now: outline(&[start_m]),
            truth: outline(truth_m),
            steady: outline(&steady),
            best: outline(&forecast.best[..len]),
            modes: modes.map(|(mode, p)| (outline(&mode[..len]), *p)).collect(),
        }
    }
}

impl Outline {
    fn new(
        agent_type: AgentType,
        [length_m, width_m]: [f32; 2],
        start_m: [f32; 2],
        heading_rad: f32,
        path_m: &[[f32; 2]],
    ) -> Self {
        let is_pedestrian = agent_type == AgentType::Pedestrian;
        let (circle_count, radius_m) =
            if is_pedestrian { (1, PEDESTRIAN_M) } else { (3, 0.5 * width_m.max(0.5)) };
        let reach_m = if is_pedestrian { 0.0 } else { (0.5 * length_m - radius_m).max(0.0) };
        let mut centres_m = [[[0.0; 2]; 3]; HORIZON_MAX];
        let (mut from, mut direction) = (start_m, [heading_rad.cos(), heading_rad.sin()]);
        for (centres, at) in centres_m.iter_mut().zip(path_m) {
            let [x, y] = [at[0] - from[0], at[1] - from[1]];
            let length_m = x.hypot(y);
            if length_m > STEP_MIN_M {
                direction = [x / length_m, y / length_m];
            }
            *centres = [0.0, reach_m, -reach_m]
                .map(|along_m| [0, 1].map(|axis| at[axis] + along_m * direction[axis]));
            from = *at;
        }
        Self { len: path_m.len(), circle_count, radius_m, centres_m }
    }

    /// The smallest distance between two outlines at a common step, and that step.
    fn gap(&self, other: &Self) -> (f32, usize) {
        let mut least = (f32::INFINITY, 0);
        for step in 0..self.len.min(other.len) {
            for a in &self.centres_m[step][..self.circle_count] {
                for b in &other.centres_m[step][..other.circle_count] {
                    let square = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
                    if square < least.0 {
                        least = (square, step);
                    }
                }
            }
        }
        (least.0.sqrt() - self.radius_m - other.radius_m, least.1)
    }
}

/// How well a score foretells the conflicts of pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Foretold {
    pub(crate) average_precision: f64,
    /// Precision at [`RECALL`].
    pub(crate) precision: f64,
    /// False alarms at [`RECALL`].
    pub(crate) false_alarms: usize,
    /// Mean time from an alarm to its conflict at [`RECALL`], s.
    pub(crate) ahead_s: f64,
}

/// The mean of the precision over the conflicts, in the order of the scores.
fn average_precision(is_conflict: &[bool]) -> f64 {
    let (mut found, mut sum) = (0.0, 0.0);
    for (before, _) in is_conflict.iter().enumerate().filter(|(_, is)| **is) {
        found += 1.0;
        sum += found / (before + 1) as f64;
    }
    sum / found
}

impl Foretold {
    /// `None` without a conflict.
    pub(crate) fn of(pairs: &[Pair], foreteller: usize) -> Option<Self> {
        let mut sorted: Vec<&Pair> = pairs.iter().collect();
        sorted.sort_by(|a, b| b.scores[foreteller].total_cmp(&a.scores[foreteller]));
        let is_conflict: Vec<bool> = sorted.iter().map(|pair| pair.conflict_s.is_some()).collect();
        let conflict_count = is_conflict.iter().filter(|is| **is).count();
        let enough = (RECALL * conflict_count as f64).ceil() as usize;
        if enough == 0 {
            return None;
        }
        let mut found = 0;
        let alarms = is_conflict.iter().take_while(|is| {
            let goes_on = found < enough;
            found += usize::from(**is && goes_on);
            goes_on
        });
        let alarm_count = alarms.count();
        let times = sorted[..alarm_count].iter().filter_map(|pair| pair.conflict_s.map(f64::from));
        Some(Self {
            average_precision: average_precision(&is_conflict),
            precision: enough as f64 / alarm_count as f64,
            false_alarms: alarm_count - enough,
            ahead_s: times.sum::<f64>() / enough as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(path_m: &[[f32; 2]]) -> Outline {
        Outline::new(AgentType::Vehicle, [4.0, 2.0], [0.0; 2], 0.0, path_m)
    }

    #[test]
    fn gaps_are_between_outlines_and_not_between_centres() {
        let ahead = outline(&[[10.0, 0.0]]);
        let (gap_m, _) = outline(&[[0.1, 0.0]]).gap(&ahead);
        assert!((gap_m - 5.9).abs() < 1e-4, "{gap_m}");
        let beside = Outline::new(AgentType::Pedestrian, [0.5; 2], [0.0; 2], 0.0, &[[0.1, 3.0]]);
        let (gap_m, _) = outline(&[[0.1, 0.0]]).gap(&beside);
        assert!((gap_m - 1.7).abs() < 1e-4, "{gap_m}");
    }

    #[test]
    fn the_gap_is_at_a_common_step() {
        let first = outline(&[[10.0, 0.0], [20.0, 0.0]]);
        let later = outline(&[[30.0, 0.0], [10.0, 0.0]]);
        assert_eq!(first.gap(&later).1, 1);
        assert!((first.gap(&later).0 - 6.0).abs() < 1e-4, "{:?}", first.gap(&later));
    }

    #[test]
    fn alarms_count_up_to_the_recall() {
        let pair = |score: f32, conflict_s: Option<f32>| Pair { conflict_s, scores: [score; 3] };
        let pairs = [
            pair(0.9, None),
            pair(0.8, Some(2.0)),
            pair(0.7, None),
            pair(0.6, Some(4.0)),
            pair(0.1, Some(1.0)),
        ];
        let foretold = Foretold::of(&pairs, 0).expect("conflicts");
        assert_eq!(foretold.false_alarms, 2);
        assert_eq!((foretold.precision, foretold.ahead_s), (0.5, 3.0));
        let expected = (1.0 / 2.0 + 2.0 / 4.0 + 3.0 / 5.0) / 3.0;
        assert!((foretold.average_precision - expected).abs() < 1e-12, "{foretold:?}");
        assert_eq!(Foretold::of(&pairs[..1], 0), None);
    }
}
