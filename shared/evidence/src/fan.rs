//! Modes from evidence: a centre path with typical residuals of similar agents.

use wire::{HORIZON_MAX, MODES_MAX};

use crate::KNOTS;

/// Initial residuals and their probabilities, for sources that provide none. The residuals hold for any step,
/// in units of their deviations, along and across the course. The 20 points minimise the distance to the
/// residuals of many roads, and are symmetric between left and right.
pub const FAN: [([f32; 2], f32); MODES_MAX] = [
    ([-0.38, 0.0], 0.165),
    ([0.14, 0.0], 0.16),
    ([-1.0, 0.0], 0.115),
    ([0.78, 0.0], 0.1),
    ([-0.35, 0.92], 0.055),
    ([-0.35, -0.92], 0.055),
    ([0.5, 0.78], 0.055),
    ([0.5, -0.78], 0.055),
    ([1.45, 0.0], 0.052),
    ([-1.95, 0.0], 0.039),
    ([-1.45, 1.35], 0.022),
    ([-1.45, -1.35], 0.022),
    ([1.5, 1.6], 0.02),
    ([1.5, -1.6], 0.02),
    ([-0.45, 2.75], 0.0185),
    ([-0.45, -2.75], 0.0185),
    ([2.45, 0.0], 0.015),
    ([-1.0, 5.2], 0.0045),
    ([-1.0, -5.2], 0.0045),
    ([-4.0, 0.0], 0.004),
];

/// Candidate positions of a fan between constant velocity (0) and the blend (1). If agents do one or the
/// other and nothing in between, the residuals about the halfway point are the narrowest.
pub(crate) const MIDDLES: [f32; 3] = [0.0, 0.5, 1.0];

/// The centre of a fan at share `reach` of the way from constant velocity (0) to the blend (1), m.
pub(crate) fn centre_m(reach: f32, velocity_m: [f32; 2], blend_m: [f32; 2]) -> [f32; 2] {
    [0, 1].map(|axis| velocity_m[axis] + reach * (blend_m[axis] - velocity_m[axis]))
}

/// Weight of a point's initial position, in matured forecasts.
const ASSUMED: f32 = 40.0;
/// Weight of the initial probabilities, in matured forecasts.
const PROBABILITY_LEN: f32 = 20.0;

/// Typical residuals of similar agents at the knots, in units of their deviations, along and across the
/// course, with the probability of each. Every residual moves its nearest point a little closer (competitive
/// learning, [MacQueen's k-means](https://projecteuclid.org/euclid.bsmsp/1200512992)).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pattern {
    /// Residual of each point at the knots.
    pub points: [[[f32; 2]; KNOTS]; MODES_MAX],
    /// Probability of each point.
    pub probability: [f32; MODES_MAX],
}

/// The learned state of a [`Pattern`].
#[derive(Clone, Debug)]
pub(crate) struct LearnedPattern {
    points: [[[f32; 2]; KNOTS]; MODES_MAX],
    expected: [f32; MODES_MAX],
    /// Number of forecasts to which each point was the nearest.
    nearest: [f32; MODES_MAX],
}

impl Default for Pattern {
    /// The pattern of [`FAN`].
    fn default() -> Self {
        Self { points: FAN.map(|(point, _)| [point; KNOTS]), probability: FAN.map(|(_, p)| p) }
    }
}

impl Pattern {
    /// Whether nothing was learned.
    #[must_use]
    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl LearnedPattern {
    pub(crate) const fn new(prior: &Pattern) -> Self {
        Self { points: prior.points, expected: prior.probability, nearest: [0.0; MODES_MAX] }
    }

    pub(crate) fn discount(&mut self, kept: f32) {
        self.nearest.iter_mut().for_each(|nearest| *nearest *= kept);
    }

    /// Moves a point closer to a residual, in units of the deviations.
    pub(crate) fn add(&mut self, point: usize, residual: &[[f32; 2]; KNOTS]) {
        self.nearest[point] += 1.0;
        let share = 1.0 / (ASSUMED + self.nearest[point]);
        let point = self.points[point].as_flattened_mut();
        point.iter_mut().zip(residual.as_flattened()).for_each(|(at, &to)| *at += share * (to - *at));
    }

    /// Calls `each` with all learned numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f32)) {
        self.points.as_flattened_mut().as_flattened_mut().iter_mut().for_each(&mut *each);
        self.nearest.iter_mut().for_each(each);
    }

    pub(crate) const fn points(&self) -> &[[[f32; 2]; KNOTS]; MODES_MAX] {
        &self.points
    }

    pub(crate) fn probability(&self) -> [f32; MODES_MAX] {
        let sum: f32 = self.nearest.iter().sum();
        std::array::from_fn(|point| {
            (self.nearest[point] + PROBABILITY_LEN * self.expected[point]) / (sum + PROBABILITY_LEN)
        })
    }
}

/// The modes of an agent about a centre path, the most probable ones first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fan {
    /// The centre, between constant velocity and the blend, step by step, m.
    pub centre_m: [[f32; 2]; HORIZON_MAX],
    /// Standard deviations of the residuals along and across the course, step by step, m.
    pub steps_m: [[f32; 2]; HORIZON_MAX],
    /// Cosine and sine of the course.
    pub course: [f32; 2],
    /// Residual of each mode along and across the course, step by step, in units of the deviations.
    pub points: [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
    /// Probability of each mode.
    pub probability: [f32; MODES_MAX],
    /// The mode's number in its [`Pattern`].
    pub numbers: [u8; MODES_MAX],
}

impl Fan {
    /// The residual of a mode at a step in the world frame, m.
    #[must_use]
    pub fn residual_m(&self, mode: usize, step: usize) -> [f32; 2] {
        let ([along, across], [cos, sin]) = (self.points[mode][step], self.course);
        let [along_m, across_m] = self.steps_m[step];
        let (along_m, across_m) = (along * along_m, across * across_m);
        [along_m * cos - across_m * sin, along_m * sin + across_m * cos]
    }

    /// The position of a mode at a step in the world frame, m.
    #[must_use]
    pub fn position_m(&self, mode: usize, step: usize) -> [f32; 2] {
        let residual_m = self.residual_m(mode, step);
        [0, 1].map(|axis| self.centre_m[step][axis] + residual_m[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fan_is_a_distribution_that_leans_to_no_side() {
        let sum: f32 = FAN.iter().map(|(_, p)| p).sum();
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        assert_eq!(FAN.iter().map(|([_, across], p)| across * p).sum::<f32>(), 0.0);
    }

    #[test]
    fn residuals_lie_along_the_course() {
        let fan = Fan {
            centre_m: [[0.0; 2]; HORIZON_MAX],
            steps_m: [[2.0, 0.5]; HORIZON_MAX],
            course: [0.0, 1.0],
            points: FAN.map(|(point, _)| [point; HORIZON_MAX]),
            probability: FAN.map(|(_, p)| p),
            numbers: [0; MODES_MAX],
        };
        assert_eq!(fan.residual_m(2, 0), [0.0, -2.0]);
        assert_eq!(fan.residual_m(4, 0), [-0.46, -0.7]);
    }

    #[test]
    fn points_move_to_what_is_nearest_to_them_and_become_probable() {
        let mut learned = LearnedPattern::new(&Pattern::default());
        for _ in 0..1000 {
            learned.add(8, &[[2.0, 0.1]; KNOTS]);
        }
        let [along, across] = learned.points()[8][3];
        assert!((along - 2.0).abs() < 0.05 && (across - 0.1).abs() < 0.01, "{along} {across}");
        assert_eq!(learned.points()[7], Pattern::default().points[7]);
        let probability = learned.probability();
        assert!(probability[8] > 0.9 && (probability.iter().sum::<f32>() - 1.0).abs() < 1e-3);
    }
}
