//! Mixtures of Gaussians that are stored until their forecasts mature.

use wire::{HORIZON_MAX, MODES_MAX};

use crate::due::Due;
use crate::fan::MIDDLES;
use crate::{Context, Fan, KNOTS, OUTLIER};

/// A published forecast as a mixture of Gaussians at the knots.
#[derive(Clone, Copy, Debug)]
pub struct Mixture<'a> {
    /// Probability of each mode.
    pub probability: &'a [f32],
    /// Position of each mode and step, m.
    pub modes_m: &'a [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
    /// Covariance of each mode and step as (xx, xy, yy), m².
    pub covariances_m2: &'a [[[f32; 3]; HORIZON_MAX]; MODES_MAX],
    /// Factors by which the mixture was widened, step by step.
    pub widths: &'a [f32; HORIZON_MAX],
    /// The network's modes, whether they were published or not, m.
    pub network_m: &'a [[[f32; 2]; HORIZON_MAX]],
    /// The fan, whether it was published or not.
    pub fan: &'a Fan,
}

/// A stored mixture.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    modes_len: usize,
    probability: [f32; MODES_MAX],
    means_m: [[[f32; 2]; MODES_MAX]; KNOTS],
    covariances_m2: [[[f32; 3]; MODES_MAX]; KNOTS],
    /// Factors by which it was widened, without the corrections.
    widths: [f32; KNOTS],
    network_count: usize,
    network_m: [[[f32; 2]; MODES_MAX]; KNOTS],
    fan_m: [[[f32; 2]; MODES_MAX]; KNOTS],
    fan_numbers: [u8; MODES_MAX],
    deviations_m: [[f32; 2]; KNOTS],
    /// Offsets from the fan to the fan about each of the [`MIDDLES`].
    to_middles_m: [[[f32; 2]; MIDDLES.len()]; KNOTS],
    /// Sums of the distances from the truth so far: of each mode of the network, of the fan, and of the fan
    /// about each of the [`MIDDLES`].
    distances_m: [[f32; MODES_MAX]; 2 + MIDDLES.len()],
}

impl Kept {
    /// State before any forecast.
    pub(super) fn empty() -> Self {
        Self {
            modes_len: 0,
            probability: [0.0; MODES_MAX],
            means_m: [[[0.0; 2]; MODES_MAX]; KNOTS],
            covariances_m2: [[[0.0; 3]; MODES_MAX]; KNOTS],
            widths: [1.0; KNOTS],
            network_count: 0,
            network_m: [[[0.0; 2]; MODES_MAX]; KNOTS],
            fan_m: [[[0.0; 2]; MODES_MAX]; KNOTS],
            fan_numbers: [0; MODES_MAX],
            deviations_m: [[1.0; 2]; KNOTS],
            to_middles_m: Default::default(),
            distances_m: Default::default(),
        }
    }

    /// Replaces an earlier mixture by a forecast whose fan has its centre at `centre_m`. It also stores the
    /// fan's position about each of the [`MIDDLES`]. The logarithms of the widths contain `corrections`.
    pub(super) fn fill(
        &mut self,
        knots: [usize; KNOTS],
        mixture: &Mixture<'_>,
        centre_m: &[[f32; 2]; KNOTS],
        middles_m: &[[[f32; 2]; KNOTS]; MIDDLES.len()],
        corrections: &[f32; KNOTS],
    ) {
        self.modes_len = mixture.probability.len();
        self.network_count = mixture.network_m.len();
        self.distances_m = Default::default();
        self.fan_numbers = mixture.fan.numbers;
        self.probability[..self.modes_len].copy_from_slice(mixture.probability);
        for (knot, step) in knots.into_iter().enumerate() {
            for mode in 0..self.modes_len {
                self.means_m[knot][mode] = mixture.modes_m[mode][step];
                self.covariances_m2[knot][mode] = mixture.covariances_m2[mode][step];
            }
            for (own, mode) in self.network_m[knot].iter_mut().zip(mixture.network_m) {
                *own = mode[step];
            }
            self.deviations_m[knot] = mixture.fan.steps_m[step];
            for (mode, own) in self.fan_m[knot].iter_mut().enumerate() {
                *own = mixture.fan.position_m(mode, step);
            }
            self.widths[knot] = mixture.widths[step] / corrections[knot].exp();
            self.to_middles_m[knot] =
                middles_m.map(|to_m| [0, 1].map(|axis| to_m[knot][axis] - centre_m[knot][axis]));
        }
    }

    /// Adds the distances of the modes from the truth at a knot.
    pub(super) fn add_distances(&mut self, knot: usize, truth_m: [f32; 2]) {
        let fan = (&self.fan_m[knot], [0.0; 2]);
        let about_middles = self.to_middles_m[knot].map(|to_m| (&self.fan_m[knot], to_m));
        let sets = [(&self.network_m[knot], [0.0; 2]), fan].into_iter().chain(about_middles);
        for (sums, (modes_m, to_m)) in self.distances_m.iter_mut().zip(sets) {
            for (sum, [x, y]) in sums.iter_mut().zip(modes_m) {
                *sum += (x + to_m[0] - truth_m[0]).hypot(y + to_m[1] - truth_m[1]);
            }
        }
    }

    /// The input of the level's computation for a knot that has matured.
    pub(super) fn due(&self, context: Context, knot: usize, truth_m: [f32; 2]) -> Due {
        Due {
            context,
            knot,
            factor: self.widths[knot],
            modes_len: self.modes_len,
            probability: self.probability,
            means_m: self.means_m[knot],
            covariances_m2: self.covariances_m2[knot],
            truth_m,
        }
    }

    /// Distances of the nearest modes of network and fan, and of the fan about each of the [`MIDDLES`].
    pub(super) fn nearest_m(&self) -> ([f32; 2], [f32; MIDDLES.len()]) {
        let least =
            |sums: [f32; MODES_MAX]| sums[..self.network_count].iter().copied().fold(f32::INFINITY, f32::min);
        let [network, fan, about_middles @ ..] = self.distances_m.map(least);
        ([network, fan], about_middles)
    }

    /// The number of the fan's nearest mode, and the residual in units of the deviations.
    pub(super) fn nearest_of_fan(&self, residuals_m: &[[f32; 2]; KNOTS]) -> (usize, [[f32; 2]; KNOTS]) {
        let fan = self.distances_m[1].iter().zip(&self.fan_numbers);
        let nearest = fan.min_by(|a, b| a.0.total_cmp(b.0)).map_or(0, |(_, &number)| usize::from(number));
        let units = std::array::from_fn(|knot| {
            [0, 1].map(|axis| {
                let deviation_m = self.deviations_m[knot][axis].max(f32::MIN_POSITIVE);
                (residuals_m[knot][axis] / deviation_m).clamp(-OUTLIER, OUTLIER)
            })
        });
        (nearest, units)
    }
}
