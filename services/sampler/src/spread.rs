//! The widths of the modes of a forecast with evidence.

use evidence::{Fan, RADIUS_90};
use kinematics::Moments;
use wire::{HORIZON_MAX, MODES_MAX};

/// Smallest and largest factor of the distances to the nearest modes.
const FACTORS: [f32; 2] = [0.3, 8.0];
/// Maximum acceleration relative to motion without control. It bounds an agent's position.
const REACH_MPS2: f32 = 10.0;
/// Error of the present position, which physics does not bound. It adds to the distance that the acceleration
/// covers. The sum is the largest 90 % radius of a mode.
const REACH_M: f32 = 2.0;
/// Largest ratio between the standard deviations of a mode along and across the course, in either direction.
const ELONGATION_MAX: f32 = 20.0;

/// The widths of an agent's modes.
///
/// A mode represents the area between itself and its neighbours. Its standard deviation is a factor times the
/// mean distance to the two nearest other modes. A mode is thus narrow among many modes and wide if the
/// others are far. Similar agents deviate less across the course than along it. Let r be the square root of
/// the ratio of the two deviations, across to along. Distances across the course are divided by r, and
/// standard deviations across it are multiplied by r.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spread {
    /// Factors of the distances to the nearest modes, step by step.
    pub(crate) factors: [f32; HORIZON_MAX],
    /// Largest variance of a position, step by step, m².
    variance_max_m2: [f32; HORIZON_MAX],
    /// Cosine and sine of the course.
    course: [f32; 2],
    /// The ratio r of the widths across and along the course, step by step.
    across: [f32; HORIZON_MAX],
}

impl Spread {
    /// The spread of an agent with this fan. `widths` are the factors, which are clamped.
    pub(crate) fn of(widths: &[f32; HORIZON_MAX], fan: &Fan, dt_s: f32) -> Self {
        let variance_max_m2 = std::array::from_fn(|step| {
            let time_s = (step + 1) as f32 * dt_s;
            ((REACH_M + 0.5 * REACH_MPS2 * time_s * time_s) / RADIUS_90).powi(2)
        });
        let factors = widths.map(|width| width.clamp(FACTORS[0], FACTORS[1]));
        let across = fan.steps_m.map(|[along_m, across_m]| {
            let ratio = across_m.max(f32::MIN_POSITIVE) / along_m.max(f32::MIN_POSITIVE);
            ratio.sqrt().clamp(1.0 / ELONGATION_MAX, ELONGATION_MAX)
        });
        Self { factors, variance_max_m2, course: fan.course, across }
    }

    /// Sets the covariances of the modes at a step, within physical limits. `present_m2` is the covariance
    /// (xx, xy, yy) of the present position.
    pub(crate) fn widen(&self, step: usize, modes: &mut [[Moments; HORIZON_MAX]], present_m2: [f32; 3]) {
        let ([cos, sin], across) = (self.course, self.across[step]);
        // Relative to one of the modes, because numbers far from the world's origin are coarse.
        let middle_m = modes.first().map_or([0.0; 2], |moments| moments[step].mean);
        let mut at = [[f32::NAN; MODES_MAX]; 2];
        for (mode, moments) in modes.iter().enumerate() {
            let [x, y] = [0, 1].map(|axis| moments[step].mean[axis] - middle_m[axis]);
            (at[0][mode], at[1][mode]) = (x * cos + y * sin, (y * cos - x * sin) / across);
        }
        let spacings_m = spacings(&at, modes.len());
        let most_m2 = self.variance_max_m2[step];
        for (moments, spacing_m) in modes.iter_mut().zip(spacings_m) {
            let along_m2 = (self.factors[step] * spacing_m).powi(2);
            let across_m2 = along_m2 * across * across;
            let widened = [
                along_m2 * cos * cos + across_m2 * sin * sin,
                (along_m2 - across_m2) * cos * sin,
                along_m2 * sin * sin + across_m2 * cos * cos,
            ];
            let [xx, xy, yy] = std::array::from_fn(|entry| present_m2[entry] + widened[entry]);
            let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
            let within = (most_m2 / largest.max(f32::MIN_POSITIVE)).min(1.0);
            moments[step].covariance = [xx, xy, yy].map(|entry| entry * within);
        }
    }
}

/// The mean distance of each point from its two nearest neighbours. With two points it is the distance
/// between them, and with one point it is 0.
fn spacings([xs, ys]: &[[f32; MODES_MAX]; 2], len: usize) -> [f32; MODES_MAX] {
    let (mut least, mut second) = ([f32::INFINITY; MODES_MAX], [f32::INFINITY; MODES_MAX]);
    for (other, (x, y)) in xs.iter().zip(ys).enumerate().take(len) {
        // By point, so that it vectorises.
        for point in 0..MODES_MAX {
            let square = (xs[point] - x).powi(2) + (ys[point] - y).powi(2);
            let square = if point == other { f32::INFINITY } else { square };
            second[point] = second[point].min(least[point].max(square));
            least[point] = least[point].min(square);
        }
    }
    std::array::from_fn(|point| match [least[point], second[point]].map(f32::sqrt) {
        [f32::INFINITY, _] => 0.0,
        [nearest_m, f32::INFINITY] => nearest_m,
        [nearest_m, next_m] => 0.5 * (nearest_m + next_m),
    })
}

#[cfg(test)]
mod tests {
    use evidence::{Agent, Evidence, Prior};
    use wire::AgentType;

    use super::*;

    const STEP: usize = 11;

    /// The covariances at the last step for modes at these positions, by a spread with this factor. The
    /// vehicle moves along `course`.
    fn widened(factor: f32, course: [f32; 2], means_m: &[[f32; 2]], present_m2: [f32; 3]) -> Vec<[f32; 3]> {
        let agent = Agent { id: 1, agent_type: AgentType::Vehicle, speed_mps: 10.0, course };
        let path_m = [[0.0; 2]; HORIZON_MAX];
        let mut fan = Evidence::new(12, 400_000_000, &Prior::default()).fan(&agent, &path_m, &path_m);
        fan.steps_m = [[4.0, 1.0]; HORIZON_MAX];
        let spread = Spread::of(&[factor; HORIZON_MAX], &fan, 0.4);
        let of_mode = |mean: &[f32; 2]| [Moments { mean: *mean, ..Moments::default() }; HORIZON_MAX];
        let mut modes: Vec<_> = means_m.iter().map(of_mode).collect();
        spread.widen(STEP, &mut modes, present_m2);
        modes.iter().map(|moments| moments[STEP].covariance).collect()
    }

    fn assert_near(given: [f32; 3], expected: [f32; 3]) {
        let holds = given.iter().zip(expected).all(|(given, expected)| (given - expected).abs() < 1e-4);
        assert!(holds, "{given:?} {expected:?}");
    }

    #[test]
    fn a_mode_is_as_wide_as_its_neighbours_are_far() {
        let means_m = [[0.0, 0.0], [2.0, 0.0], [6.0, 0.0], [20.0, 0.0]];
        let along_m = [4.0, 3.0, 5.0, 16.0];
        // Similar agents deviate four times as much along the course as across it, so modes are half as wide
        // across.
        let covariances_m2 = widened(0.5, [1.0, 0.0], &means_m, [0.04, 0.01, 0.09]);
        for (given, along_m) in covariances_m2.into_iter().zip(along_m) {
            let along_m2 = (0.5_f32 * along_m).powi(2);
            assert_near(given, [along_m2 + 0.04, 0.01, 0.25 * along_m2 + 0.09]);
        }
    }

    #[test]
    fn distances_across_the_course_count_as_agents_deviate() {
        // A metre across counts like two metres along.
        let means_m = [[0.0, 0.0], [0.0, 1.0], [2.0, 0.0]];
        assert_near(widened(1.0, [1.0, 0.0], &means_m, [0.0; 3])[0], [4.0, 0.0, 1.0]);
        let turned_m = means_m.map(|[x, y]| [-y, x]);
        assert_near(widened(1.0, [0.0, 1.0], &turned_m, [0.0; 3])[0], [1.0, 0.0, 4.0]);
    }

    #[test]
    fn no_mode_is_wider_than_physics_lets_the_agent_be_nor_narrower_than_its_present_position() {
        let far = widened(1.0, [1.0, 0.0], &[[0.0, 0.0], [1e6, 0.0]], [0.0; 3]);
        let most_m = (REACH_M + 0.5 * REACH_MPS2 * 4.8 * 4.8) / RADIUS_90;
        assert!(far.iter().all(|[xx, ..]| (xx.sqrt() / most_m - 1.0).abs() < 1e-3), "{far:?}");
        for means_m in [[[3.0, 4.0]; 1].as_slice(), &[[3.0, 4.0]; 5]] {
            let present_m2 = [0.04, 0.01, 0.09];
            widened(1.0, [1.0, 0.0], means_m, present_m2)
                .into_iter()
                .for_each(|of| assert_near(of, present_m2));
        }
    }
}
