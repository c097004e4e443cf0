//! The noise of positions by the view from the sensor.
//!
//! **Distance.** Far agents have few points, so their positions are often less exact. For each type, the
//! variance at four distances is learned relative to the variance of all its positions. Between these
//! distances, the logarithm of the deviation is linear in the logarithm of the distance.
//!
//! **Line of sight.** A camera measures directions better than distances, a radar the reverse. For each type,
//! the variances a along and c across the line of sight are learned. From e = (a − c) / (a + c) follows the
//! covariance of a position with the variance σ² per axis, seen in the direction φ:
//!
//! ```text
//! R = σ² (I + e [[cos 2φ, sin 2φ], [sin 2φ, −cos 2φ]])
//! ```

use filters::noise::Scale;
use kinematics::hypot;
use wire::{AgentType, Header, flags};

/// Distances from the sensor for which a variance is learned.
const DISTANCES_M: [f64; 4] = [10.0, 20.0, 40.0, 80.0];
/// Number of contrasts as which the prior counts: the variance is the same at all distances.
const PRIOR_COUNT: f64 = 60.0;
const COUNT_MAX: f64 = 400.0;
/// Bounds of a deviation relative to the deviation of all positions.
const FACTOR_RANGE: (f64, f64) = (0.2, 5.0);
/// Differences of the two variances up to this e occur by chance, and in the motion itself.
const ELONGATION_MIN: f64 = 0.3;
/// Largest e. At 0.98 the deviation along the line of sight is ten times the deviation across it.
const ELONGATION_MAX: f64 = 0.98;

/// Learned variances of one type by the view, relative to the variance of all its positions.
#[derive(Clone, Copy, Debug)]
pub struct ByView {
    at_distances: [Scale; DISTANCES_M.len()],
    /// Along and across the line of sight.
    by_direction: [Scale; 2],
}

impl ByView {
    pub const fn new() -> Self {
        let equal = Scale::new(1.0, PRIOR_COUNT, COUNT_MAX);
        Self { at_distances: [equal; DISTANCES_M.len()], by_direction: [equal; 2] }
    }

    /// Learns from the contrasts of a position, in units of the deviation of all positions, seen over this way.
    pub fn add(&mut self, [along_x, along_y]: [f64; 2], [x, y]: [f64; 2]) {
        let distance_m = hypot(along_x, along_y);
        let (below, share) = place(distance_m);
        let at_distance = &mut self.at_distances[if share < 0.5 { below } else { below + 1 }];
        [x, y].into_iter().for_each(|contrast| at_distance.add(contrast));
        if distance_m > 0.0 {
            let [along, across] = &mut self.by_direction;
            along.add((x * along_x + y * along_y) / distance_m);
            across.add((y * along_x - x * along_y) / distance_m);
        }
    }

    /// Logarithms of the relative deviations.
    fn logarithms(&self) -> [f64; DISTANCES_M.len()] {
        let (least, most) = FACTOR_RANGE;
        self.at_distances.each_ref().map(|scale| scale.variance().sqrt().clamp(least, most).ln())
    }

    /// e of the module's equation; 0 if it may be chance.
    fn elongation(&self) -> f64 {
        let [along, across] = self.by_direction.each_ref().map(Scale::variance);
        let elongation = (along - across) / (along + across);
        if elongation.abs() > ELONGATION_MIN {
            elongation.clamp(-ELONGATION_MAX, ELONGATION_MAX)
        } else {
            0.0
        }
    }
}

/// The factors on the deviations of positions in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFactors {
    /// Position of the sensor, if it is known.
    sensor_m: Option<[f64; 2]>,
    /// By type and distance.
    logarithms: [[f64; DISTANCES_M.len()]; 3],
    /// e of the module's equation, by type.
    elongations: [f64; 3],
}

impl ViewFactors {
    /// The same deviation at all distances and in all directions.
    pub const NONE: Self =
        Self { sensor_m: None, logarithms: [[0.0; DISTANCES_M.len()]; 3], elongations: [0.0; 3] };

    pub fn new(header: &Header, of_types: [&ByView; 3]) -> Self {
        Self {
            sensor_m: header.has(flags::SEEN_FROM_EGO).then(|| header.ego_m.map(f64::from)),
            logarithms: of_types.map(ByView::logarithms),
            elongations: of_types.map(ByView::elongation),
        }
    }

    /// The way from the sensor to a position, if the sensor's position is known.
    pub fn line_of_sight_m(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        self.sensor_m.map(|[from_x, from_y]| [x - from_x, y - from_y])
    }

    /// [`filters::Observation::elongation`] of a position with this variance per axis.
    pub fn elongation(&self, agent_type: AgentType, position_m: [f64; 2], variance: f64) -> [f64; 2] {
        let share = self.elongations[agent_type.index()];
        match self.line_of_sight_m(position_m) {
            Some([x, y]) if share != 0.0 && (x, y) != (0.0, 0.0) => {
                let factor = variance * share / (x * x + y * y);
                [factor * (x * x - y * y), factor * 2.0 * x * y]
            }
            _ => [0.0; 2],
        }
    }

    /// The factor on the deviation of a position.
    pub fn factor(&self, agent_type: AgentType, position_m: [f64; 2]) -> f64 {
        let Some([x, y]) = self.line_of_sight_m(position_m) else { return 1.0 };
        let distance_m = hypot(x, y);
        let (below, share) = place(distance_m);
        let logarithms = &self.logarithms[agent_type.index()];
        (logarithms[below] + share * (logarithms[below + 1] - logarithms[below])).exp()
    }
}

/// The number of the last of [`DISTANCES_M`] below a distance, and the share of the way to the next one.
fn place(distance_m: f64) -> (usize, f64) {
    let (first, last) = (DISTANCES_M[0], DISTANCES_M[DISTANCES_M.len() - 1]);
    let doublings = (distance_m.clamp(first, last) / first).log2();
    let below = (doublings as usize).min(DISTANCES_M.len() - 2);
    (below, doublings - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_lie_between_two_distances() {
        for (distance_m, expected) in
            [(0.0, 0.0), (10.0, 0.0), (20.0, 1.0), (40.0, 2.0), (80.0, 3.0), (1e9, 3.0)]
        {
            let (below, share) = place(distance_m);
            assert!(below + 1 < DISTANCES_M.len() && (0.0..=1.0).contains(&share), "{distance_m}");
            assert!((below as f64 + share - expected).abs() < 1e-9, "{distance_m}");
        }
    }

    #[test]
    fn noise_that_grows_with_the_distance_is_learned() {
        let mut learned = ByView::new();
        for sign in [-1.0, 1.0].repeat(300) {
            learned.add([8.0, 0.0], [0.3 * sign; 2]);
            learned.add([0.0, 100.0], [3.0 * sign; 2]);
        }
        let header = Header { flags: flags::SEEN_FROM_EGO, ego_m: [5.0, 0.0], ..Header::new(1, 0, 0) };
        let factors = ViewFactors::new(&header, [&learned; 3]);
        let at = |x| factors.factor(AgentType::Vehicle, [x, 0.0]);
        assert!(at(13.0) < 0.6 && (0.8..1.2).contains(&at(33.0)) && at(95.0) > 2.0, "{factors:?}");
        let unknown = ViewFactors::new(&Header::new(1, 0, 0), [&learned; 3]);
        assert_eq!(unknown.factor(AgentType::Vehicle, [95.0, 0.0]).to_bits(), 1.0_f64.to_bits());
    }

    #[test]
    fn noise_along_the_line_of_sight_is_learned() {
        let mut learned = ByView::new();
        for sign in [-1.0, 1.0].repeat(300) {
            learned.add([8.0, 0.0], [1.3 * sign, 0.2 * sign]);
            learned.add([0.0, 8.0], [-0.2 * sign, 1.3 * sign]);
        }
        let header = Header { flags: flags::SEEN_FROM_EGO, ego_m: [5.0, 0.0], ..Header::new(1, 0, 0) };
        let factors = ViewFactors::new(&header, [&learned; 3]);
        let near = |[a, b]: [f64; 2], [c, d]: [f64; 2]| (a - c).abs() < 0.1 && (b - d).abs() < 0.1;
        for (position_m, expected) in
            [([25.0, 0.0], [2.0, 0.0]), ([5.0, 9.0], [-2.0, 0.0]), ([7.0, -2.0], [0.0, -2.0])]
        {
            let found = factors.elongation(AgentType::Cyclist, position_m, 2.1);
            assert!(near(found, expected), "{position_m:?}: {found:?}");
        }
        let equal = ViewFactors::new(&header, [&ByView::new(); 3]);
        let found = equal.elongation(AgentType::Cyclist, [25.0, 0.0], 2.1);
        assert_eq!(found.map(f64::to_bits), [0; 2]);
    }
}
