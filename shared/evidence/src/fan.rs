//! Modes of their own: the blend with typical residuals of agents alike.

use wire::{HORIZON_MAX, MODES_MAX};

/// Residuals at any step in units of their deviations, along and across the course, and how probable each is:
/// the least that 20 points miss of the residuals of many roads, the same to the left and to the right.
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
/// Deviation of the residuals about the nearest point of [`FAN`], in units of their own.
const WITHIN: f32 = 0.36;

/// How far agents alike deviate from the blend, along and across their course, step by step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviations {
    /// Standard deviations, m.
    pub steps_m: [[f32; 2]; HORIZON_MAX],
    /// Cosine and sine of the course.
    pub course: [f32; 2],
}

impl Deviations {
    /// The residual of a mode at a step in the world frame, m.
    #[must_use]
    pub fn residual_m(&self, mode: usize, step: usize) -> [f32; 2] {
        let ([along, across], [cos, sin]) = (FAN[mode].0, self.course);
        let [along_m, across_m] = self.steps_m[step];
        let (along_m, across_m) = (along * along_m, across * across_m);
        [along_m * cos - across_m * sin, along_m * sin + across_m * cos]
    }

    /// The covariance of every mode at a step as (xx, xy, yy), m².
    #[must_use]
    pub fn covariance_m2(&self, step: usize) -> [f32; 3] {
        let [along, across] = self.steps_m[step].map(|deviation_m| (WITHIN * deviation_m).powi(2));
        let [cos, sin] = self.course;
        let xy = (along - across) * cos * sin;
        [along * cos * cos + across * sin * sin, xy, along * sin * sin + across * cos * cos]
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
    fn residuals_and_covariances_lie_along_the_course() {
        let deviations = Deviations { steps_m: [[2.0, 0.5]; HORIZON_MAX], course: [0.0, 1.0] };
        assert_eq!(deviations.residual_m(2, 0), [0.0, -2.0]);
        assert_eq!(deviations.residual_m(4, 0), [-0.46, -0.7]);
        let [xx, xy, yy] = deviations.covariance_m2(3);
        assert!(
            xy.abs() < 1e-6 && (xx - 0.0324).abs() < 1e-4 && (yy - 0.5184).abs() < 1e-4,
            "{xx} {xy} {yy}"
        );
    }
}
