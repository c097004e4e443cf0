use wire::{AgentType, Forecast, HORIZON_MAX, MODES_MAX};

use crate::{APART_MAX_M, APART_MIN_M, Body, CONFLICT_M, NEAR_M, Outline, STANDS_MPS};

/// Numbers of [`Signs::numbers`].
pub const SIGNS: usize = 12;
/// Parts of the horizon until which conflicts are counted: a quarter, half, and all of it.
const PARTS: [usize; 3] = [4, 2, 1];
/// A smaller probability has its logarithm.
const LEAST: f32 = 1e-4;
/// Cosine of the angle up to which two agents have the same or opposite directions.
const ALIKE: f32 = 0.7;
/// Bounds of the gap of the single best forecasts, m.
const GAP_M: [f32; 2] = [-1.0, 4.0];
/// Bounds of the speed at which two agents approach each other, m/s.
const CLOSING_MPS: [f32; 2] = [-5.0, 15.0];

/// What the forecasts of two agents say about their gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// Probability that independent modes come closer than [`CONFLICT_M`] within a quarter of the horizon, half of
    /// it, and all of it.
    pub conflict: [f32; PARTS.len()],
    /// Probability that independent modes come closer than [`NEAR_M`] within the horizon.
    pub near: f32,
    /// Mean time until the modes that come closer than [`CONFLICT_M`] do so, or than [`NEAR_M`] if none comes
    /// closer, s.
    pub in_s: f32,
    stands: bool,
    pedestrians: usize,
    direction: Direction,
    /// Gap of the single best forecasts, m.
    best_gap_m: f32,
    /// Distance now, m, and the speed at which it falls, m/s.
    apart_m: f32,
    closing_mps: f32,
}

/// How the directions of two agents differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Same,
    Opposite,
    Crossing,
}

/// An agent with its forecast.
#[derive(Clone, Debug)]
pub struct Moving {
    body: Body,
    ahead: [f32; 2],
    velocity_mps: [f32; 2],
    now: Outline,
    best: Outline,
    modes: Outline,
    probability: [f32; MODES_MAX],
}

/// Memory for the distances of all pairs of modes.
#[derive(Debug)]
pub struct Room {
    least_m2: [[f32; MODES_MAX]; MODES_MAX],
    /// First steps below [`CONFLICT_M`] and [`NEAR_M`].
    first: [[[u8; MODES_MAX]; MODES_MAX]; 2],
}

impl Default for Room {
    fn default() -> Self {
        Self { least_m2: [[0.0; MODES_MAX]; MODES_MAX], first: [[[0; MODES_MAX]; MODES_MAX]; 2] }
    }
}

impl Room {
    /// The place where the pair that was judged last meets: the middle between both agents, m. It belongs to the most
    /// probable two modes with a gap below [`CONFLICT_M`], at the first such step. Without such modes the bound is
    /// [`NEAR_M`].
    pub(crate) fn meeting_m(&self, a: &Moving, b: &Moving) -> [f32; 2] {
        let most_probable = |first: &[[u8; MODES_MAX]; MODES_MAX]| {
            let modes = (0..MODES_MAX).flat_map(|mode| (0..MODES_MAX).map(move |other| (mode, other)));
            let meeting = modes.filter(|(mode, other)| first[*mode][*other] != u8::MAX);
            let p = |(mode, other): (usize, usize)| a.probability[mode] * b.probability[other];
            let best = meeting.max_by(|one, another| p(*one).total_cmp(&p(*another)))?;
            (p(best) > 0.0).then_some((best, usize::from(first[best.0][best.1])))
        };
        let Some(((mode, other), step)) = self.first.iter().find_map(most_probable) else {
            return a.body.position_m;
        };
        let [one, another] = [a.modes.middle_m(step, mode), b.modes.middle_m(step, other)];
        [0, 1].map(|axis| 0.5 * (one[axis] + another[axis]))
    }
}

impl Moving {
    /// The agent of a forecast; `None` for an unknown type, and without modes.
    #[must_use]
    pub fn of(forecast: &Forecast, horizon_len: usize) -> Option<Self> {
        let mut moving = Self {
            body: Body {
                agent_type: AgentType::Vehicle,
                size_m: [0.0; 2],
                position_m: [0.0; 2],
                heading_rad: 0.0,
            },
            ahead: [1.0, 0.0],
            velocity_mps: [0.0; 2],
            now: Outline::default(),
            best: Outline::default(),
            modes: Outline::default(),
            probability: [0.0; MODES_MAX],
        };
        moving.follow(forecast, horizon_len).then_some(moving)
    }

    /// Becomes the agent of a forecast. Returns false, and has no use, if [`Moving::of`] would be `None`.
    pub(crate) fn follow(&mut self, forecast: &Forecast, horizon_len: usize) -> bool {
        let modes_len = (forecast.modes_len as usize).min(MODES_MAX);
        let Some(body) = Body::of(forecast).filter(|_| modes_len > 0) else { return false };
        self.body = body;
        self.ahead = [body.heading_rad.cos(), body.heading_rad.sin()];
        self.velocity_mps = [forecast.vx_mps, forecast.vy_mps];
        self.now.draw(&body, [&[body.position_m][..]]);
        let len = horizon_len.min(HORIZON_MAX);
        self.best.draw(&body, [&forecast.best[..len]]);
        self.modes.draw(&body, forecast.modes[..modes_len].iter().map(|mode| &mode[..len]));
        self.probability = [0.0; MODES_MAX];
        self.probability[..modes_len].copy_from_slice(&forecast.probability[..modes_len]);
        true
    }

    fn stands(&self) -> bool {
        let [vx, vy] = self.velocity_mps;
        vx.hypot(vy) <= STANDS_MPS
    }

    /// The way to another agent, m.
    fn way_m(&self, other: &Self) -> [f32; 2] {
        [0, 1].map(|axis| other.body.position_m[axis] - self.body.position_m[axis])
    }

    /// Distance to another agent, m, and the speed at which it falls, m/s.
    fn approach(&self, other: &Self) -> (f32, f32) {
        let [x, y] = self.way_m(other);
        let [vx, vy] = [0, 1].map(|axis| other.velocity_mps[axis] - self.velocity_mps[axis]);
        let apart_m = x.hypot(y);
        (apart_m, -(x * vx + y * vy) / apart_m.max(f32::MIN_POSITIVE))
    }
}

/// Whether a pair is judged: one of them moves, and they are neither far apart nor close already.
#[must_use]
pub fn are_judged(a: &Moving, b: &Moving) -> bool {
    let [x, y] = a.way_m(b);
    let is_in_reach = x * x + y * y <= APART_MAX_M * APART_MAX_M;
    is_in_reach && !(a.stands() && b.stands()) && a.now.gap(&b.now).0 >= APART_MIN_M
}

impl Signs {
    /// The signs of a pair. `None` if it is not judged, or no two modes come nearer than [`NEAR_M`].
    #[must_use]
    pub fn of(a: &Moving, b: &Moving, dt_s: f32, room: &mut Room) -> Option<Self> {
        let len = a.modes.len.min(b.modes.len);
        let is_near = |step| a.modes.may_be_within(&b.modes, step, NEAR_M);
        let first = (0..len).find(|step| is_near(*step))?;
        if !are_judged(a, b) {
            return None;
        }
        room.least_m2.as_flattened_mut().fill(f32::INFINITY);
        room.first.as_flattened_mut().as_flattened_mut().fill(u8::MAX);
        let radii_m = a.modes.radius_m + b.modes.radius_m;
        let bounds_m2 = [CONFLICT_M, NEAR_M].map(|gap_m| (gap_m + radii_m).powi(2));
        for step in (first..len).filter(|step| is_near(*step)) {
            a.modes.lower(&b.modes, step, &mut room.least_m2);
            for (first, bound_m2) in room.first.iter_mut().zip(bounds_m2) {
                let first = first.as_flattened_mut().iter_mut();
                for (first, least_m2) in first.zip(room.least_m2.as_flattened()) {
                    let now = if *least_m2 < bound_m2 { step as u8 } else { u8::MAX };
                    *first = (*first).min(now);
                }
            }
        }
        // Of both bounds, the probability that modes come closer, and the sum for the mean step.
        let mut sums = [[0.0, 0.0]; 2];
        let mut conflict = [0.0; PARTS.len()];
        for (mode, p_a) in a.probability.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            for (other, p_b) in b.probability.iter().enumerate() {
                let p = p_a * p_b;
                for (sums, first) in sums.iter_mut().zip(&room.first) {
                    let step = first[mode][other];
                    if step != u8::MAX {
                        sums[0] += p;
                        sums[1] += p * (f32::from(step) + 1.0);
                    }
                }
                for (sum, part) in conflict.iter_mut().zip(PARTS) {
                    let is_early = usize::from(room.first[0][mode][other]) < len.div_ceil(part);
                    *sum += if is_early { p } else { 0.0 };
                }
            }
        }
        let [in_conflict, near] = sums;
        let timed = if in_conflict[0] >= LEAST { in_conflict } else { near };
        let cosine = a.ahead[0] * b.ahead[0] + a.ahead[1] * b.ahead[1];
        let (apart_m, closing_mps) = a.approach(b);
        (near[0] >= LEAST).then(|| Self {
            conflict,
            near: near[0],
            in_s: timed[1] / timed[0] * dt_s,
            stands: a.stands() || b.stands(),
            pedestrians: [a, b].iter().filter(|of| of.body.agent_type == AgentType::Pedestrian).count(),
            direction: match cosine {
                _ if cosine > ALIKE => Direction::Same,
                _ if cosine < -ALIKE => Direction::Opposite,
                _ => Direction::Crossing,
            },
            best_gap_m: a.best.gap(&b.best).0,
            apart_m,
            closing_mps,
        })
    }

    /// The signs as numbers: logarithms of the probabilities of a conflict within a quarter, half and all of the
    /// horizon and of nearness, then 1 for each that applies of: one stands, one is a pedestrian, both are, same
    /// directions, opposite directions. Then the gap of the single best forecasts, the logarithm of the distance, and
    /// the speed at which the agents approach each other.
    #[must_use]
    pub fn numbers(&self) -> [f32; SIGNS] {
        let ln = |p: f32| p.max(LEAST).ln();
        let [quarter, half, all] = self.conflict.map(ln);
        let is = |applies: bool| f32::from(u8::from(applies));
        [
            quarter,
            half,
            all,
            ln(self.near),
            is(self.stands),
            is(self.pedestrians == 1),
            is(self.pedestrians == 2),
            is(self.direction == Direction::Same),
            is(self.direction == Direction::Opposite),
            self.best_gap_m.clamp(GAP_M[0], GAP_M[1]),
            self.apart_m.max(1.0).ln(),
            self.closing_mps.clamp(CLOSING_MPS[0], CLOSING_MPS[1]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HORIZON_LEN: usize = 12;
    const DT_S: f32 = 0.4;

    /// A forecast from a place at a velocity, whose modes have these factors of the speed and probabilities.
    fn forecast(agent_type: AgentType, at_m: [f32; 2], v_mps: [f32; 2], modes: &[(f32, f32)]) -> Forecast {
        let mut forecast = Forecast {
            agent_type: agent_type as u32,
            modes_len: modes.len() as u32,
            heading_rad: v_mps[1].atan2(v_mps[0]),
            length_m: 4.0,
            width_m: 2.0,
            ..Forecast::default()
        };
        [forecast.x_m, forecast.y_m] = at_m;
        [forecast.vx_mps, forecast.vy_mps] = v_mps;
        for (mode, (factor, probability)) in modes.iter().enumerate() {
            forecast.probability[mode] = *probability;
            for step in 0..HORIZON_LEN {
                let in_s = (step + 1) as f32 * DT_S * factor;
                forecast.modes[mode][step] = [0, 1].map(|axis| at_m[axis] + in_s * v_mps[axis]);
            }
        }
        forecast.best = forecast.modes[0];
        forecast
    }

    fn signs(a: &Forecast, b: &Forecast) -> Option<Signs> {
        let moving = |of| Moving::of(of, HORIZON_LEN).expect("modes");
        Signs::of(&moving(a), &moving(b), DT_S, &mut Room::default())
    }

    #[test]
    fn only_the_modes_that_meet_count_and_only_up_to_their_time() {
        // The outlines are 6 m apart. The fast mode closes 2 m a second, and the slow one keeps away.
        let behind = forecast(AgentType::Vehicle, [0.0; 2], [4.0, 0.0], &[(1.0, 0.25), (0.5, 0.75)]);
        let ahead = forecast(AgentType::Vehicle, [10.0, 0.0], [2.0, 0.0], &[(1.0, 1.0)]);
        let signs = signs(&behind, &ahead).expect("near");
        assert_eq!(signs.conflict, [0.0, 0.0, 0.25]);
        assert_eq!(signs.near, 0.25);
        // Below 0.5 m after 2.75 s, which the step at 2.8 s shows.
        assert!((signs.in_s - 2.8).abs() < 1e-5, "{signs:?}");
        assert_eq!((signs.stands, signs.pedestrians, signs.direction), (false, 0, Direction::Same));
        // The first modes meet after 2.75 s and overlap at the end. The agents are 10 m apart.
        assert_eq!(signs.numbers()[4..], [0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 10.0_f32.ln(), 2.0]);
    }

    #[test]
    fn signs_do_not_depend_on_the_order_of_the_pair() {
        let car = forecast(AgentType::Vehicle, [0.0; 2], [8.0, 0.0], &[(1.0, 0.5), (0.7, 0.3), (0.2, 0.2)]);
        let person = forecast(AgentType::Pedestrian, [16.0, -4.0], [0.0, 1.5], &[(1.0, 0.6), (0.0, 0.4)]);
        let (one, other) = (signs(&car, &person).expect("near"), signs(&person, &car).expect("near"));
        assert_eq!((one.pedestrians, one.direction), (1, Direction::Crossing));
        for (a, b) in one.numbers().into_iter().zip(other.numbers()) {
            assert!((a - b).abs() < 1e-5, "{one:?} {other:?}");
        }
    }

    #[test]
    fn some_pairs_are_not_judged() {
        let at = |x_m: f32, v_mps: f32| forecast(AgentType::Vehicle, [x_m, 0.0], [v_mps, 0.0], &[(1.0, 1.0)]);
        assert!(signs(&at(0.0, 5.0), &at(8.0, 0.0)).is_some());
        assert_eq!(signs(&at(0.0, 0.4), &at(6.0, 0.0)), None, "both stand");
        assert_eq!(signs(&at(0.0, 5.0), &at(4.9, 0.0)), None, "closer than 1 m already");
        assert_eq!(signs(&at(0.0, 20.0), &at(60.5, 0.0)), None, "too far apart");
        assert_eq!(signs(&at(0.0, 5.0), &at(40.0, 0.0)), None, "no modes come near");
    }
}
