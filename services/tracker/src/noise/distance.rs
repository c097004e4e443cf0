//! The noise of positions by the distance from the sensor.
//!
//! Far agents have few points, so their positions are often less exact. For each type, the variance at four
//! distances is learned relative to the variance of all its positions. Between these distances, the logarithm
//! of the deviation is linear in the logarithm of the distance.

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

/// Learned variances of one type by distance, relative to the variance of all its positions.
#[derive(Clone, Copy, Debug)]
pub struct ByDistance([Scale; DISTANCES_M.len()]);

impl ByDistance {
    pub const fn new() -> Self {
        Self([Scale::new(1.0, PRIOR_COUNT, COUNT_MAX); DISTANCES_M.len()])
    }

    /// Learns from a contrast in units of the deviation of all positions.
    pub fn add(&mut self, distance_m: f64, contrast: f64) {
        let (below, share) = place(distance_m);
        self.0[if share < 0.5 { below } else { below + 1 }].add(contrast);
    }

    /// Logarithms of the relative deviations.
    fn logarithms(&self) -> [f64; DISTANCES_M.len()] {
        let (least, most) = FACTOR_RANGE;
        self.0.each_ref().map(|scale| scale.variance().sqrt().clamp(least, most).ln())
    }
}

/// The factors on the deviations of positions in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistanceFactors {
    /// Position of the sensor, if it is known.
    sensor_m: Option<[f64; 2]>,
    /// By type and distance.
    logarithms: [[f64; DISTANCES_M.len()]; 3],
}

impl DistanceFactors {
    /// The same deviation at all distances.
    pub const NONE: Self = Self { sensor_m: None, logarithms: [[0.0; DISTANCES_M.len()]; 3] };

    pub fn new(header: &Header, of_types: [&ByDistance; 3]) -> Self {
        let sensor_m = header.has(flags::SEEN_FROM_EGO).then(|| header.ego_m.map(f64::from));
        Self { sensor_m, logarithms: of_types.map(ByDistance::logarithms) }
    }

    /// Distance of a position from the sensor, if the sensor's position is known.
    pub fn distance_m(&self, [x, y]: [f64; 2]) -> Option<f64> {
        self.sensor_m.map(|[from_x, from_y]| hypot(x - from_x, y - from_y))
    }

    /// The factor on the deviation of a position.
    pub fn factor(&self, agent_type: AgentType, position_m: [f64; 2]) -> f64 {
        let Some(distance_m) = self.distance_m(position_m) else { return 1.0 };
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
        let mut learned = ByDistance::new();
        for sign in [-1.0, 1.0].repeat(300) {
            learned.add(8.0, 0.3 * sign);
            learned.add(100.0, 3.0 * sign);
        }
        let header = Header { flags: flags::SEEN_FROM_EGO, ego_m: [5.0, 0.0], ..Header::new(1, 0, 0) };
        let factors = DistanceFactors::new(&header, [&learned; 3]);
        let at = |x| factors.factor(AgentType::Vehicle, [x, 0.0]);
        assert!(at(13.0) < 0.6 && (0.8..1.2).contains(&at(33.0)) && at(95.0) > 2.0, "{factors:?}");
        let unknown = DistanceFactors::new(&Header::new(1, 0, 0), [&learned; 3]);
        assert_eq!(unknown.factor(AgentType::Vehicle, [95.0, 0.0]).to_bits(), 1.0_f64.to_bits());
    }
}
