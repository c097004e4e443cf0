//! Highest-density regions of a Gaussian mixture: the smallest areas that contain a given probability.
//!
//! The region of *level* q is the set of positions whose density exceeds a threshold, chosen so that the
//! region has probability q. A truth is on the border of exactly one region and inside every region of a
//! higher level. Its level is the probability of all positions that are likelier than the truth. Levels of
//! calibrated forecasts are uniform in 0..1.

use std::f32::consts::{LN_2, LOG2_E, TAU};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A position (x, y) in metres.
type Point = [f32; 2];

/// Number of draws from all components together. Every component of positive probability has at least one.
const DRAWS: usize = 400;
/// Smallest variance: no position is known better than to a centimetre.
const VARIANCE_MIN_M2: f32 = 1e-4;
/// Golden section: any number of its multiples, modulo 1, is spread evenly.
const GOLDEN: f32 = 0.618_034;

/// The level, 0 to 1, of the highest-density region of a Gaussian mixture that has `truth` on its border. The
/// truth is inside the 90 % region if its level is at most 0.9.
///
/// Covariances are (xx, xy, yy) in m². The probabilities need not sum to 1. The level is the share of draws
/// that are likelier than the truth. Each component has a fixed number of draws, stratified into rings of
/// equal probability and spread evenly around. The error of one level is nearly always below 0.01, and the
/// error of the mean of many levels vanishes. The same seed gives the same level. The level is 1 if no
/// probability is positive or a component is not a number. Cost: about 10 µs for 20 components.
///
/// # Panics
/// If the numbers of means, covariances and probabilities differ.
#[must_use]
pub fn highest_density_level(
    means: &[Point],
    covariances: &[[f32; 3]],
    probability: &[f32],
    truth: Point,
    seed: u64,
) -> f64 {
    HighestDensity::default().level(means, covariances, probability, truth, seed)
}

/// [`highest_density_level`] with reusable memory. From the second call on it allocates nothing, unless the
/// mixture has more components than before.
#[derive(Clone, Debug, Default)]
pub struct HighestDensity {
    components: Vec<Component>,
    draws: Vec<usize>,
    positions: Positions,
    densities: Vec<f32>,
}

impl HighestDensity {
    /// Memory for mixtures of up to `components_max` components.
    #[must_use]
    pub fn with_room(components_max: usize) -> Self {
        let positions_max = DRAWS + components_max + 1;
        let axis = || Vec::with_capacity(positions_max);
        Self {
            components: Vec::with_capacity(components_max),
            draws: Vec::with_capacity(components_max),
            positions: Positions { x: axis(), y: axis() },
            densities: axis(),
        }
    }

    /// As [`highest_density_level`].
    ///
    /// # Panics
    /// If the numbers of means, covariances and probabilities differ.
    pub fn level(
        &mut self,
        means: &[Point],
        covariances: &[[f32; 3]],
        probability: &[f32],
        truth: Point,
        seed: u64,
    ) -> f64 {
        self.draw(means, covariances, probability, truth, seed);
        let Self { components, draws, positions, densities } = self;
        // The origin is the truth.
        positions.push([0.0; 2]);
        positions.write_densities(components, densities);
        let Some((&at_truth, mut at_draws)) = densities.split_last().filter(|(at_truth, _)| **at_truth > 0.0)
        else {
            return 1.0;
        };
        let mut level = 0.0;
        for (component, &draw_count) in components.iter().zip(&*draws) {
            let (own, others) = at_draws.split_at(draw_count);
            let likelier = own.iter().filter(|density| **density > at_truth).count();
            level += f64::from(component.probability) * likelier as f64 / draw_count as f64;
            at_draws = others;
        }
        level.min(1.0)
    }

    /// The area in m² of the highest-density region of a level; 0 if no probability is positive.
    ///
    /// With the region R and the density p, the area ∫ 1_R dx is the mean of 1_R / p over draws of p. The
    /// error of one area is nearly always below a tenth, and the error of the mean of many areas vanishes.
    ///
    /// # Panics
    /// If the numbers of means, covariances and probabilities differ.
    pub fn area_m2(
        &mut self,
        means: &[Point],
        covariances: &[[f32; 3]],
        probability: &[f32],
        level: f64,
        seed: u64,
    ) -> f64 {
        let origin = means.first().copied().unwrap_or_default();
        self.draw(means, covariances, probability, origin, seed);
        let Self { components, draws, positions, densities } = self;
        positions.write_densities(components, densities);
        let weights = components.iter().zip(&*draws).flat_map(|(component, &draw_count)| {
            std::iter::repeat_n(f64::from(component.probability) / draw_count as f64, draw_count)
        });
        let mut weighted: Vec<(f32, f64)> = densities.iter().copied().zip(weights).collect();
        weighted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let unit = f64::from(highest_log2_weight(components)).exp2() / f64::from(TAU);
        let (mut area_m2, mut left) = (0.0, level);
        for (density, weight) in weighted {
            if left <= 0.0 {
                break;
            }
            area_m2 += weight.min(left) / (unit * f64::from(density));
            left -= weight;
        }
        area_m2
    }

    /// Draws from the components of positive probability, relative to `origin`.
    fn draw(
        &mut self,
        means: &[Point],
        covariances: &[[f32; 3]],
        probability: &[f32],
        origin: Point,
        seed: u64,
    ) {
        assert_eq!(means.len(), probability.len(), "one probability per mean");
        assert_eq!(covariances.len(), probability.len(), "one probability per covariance");
        let Self { components, draws, positions, .. } = self;
        let possible = || probability.iter().enumerate().filter(|(_, p)| **p > 0.0);
        let total: f32 = possible().map(|(_, p)| p).sum();
        components.clear();
        components.extend(possible().map(|(k, p)| {
            let centre = [means[k][0] - origin[0], means[k][1] - origin[1]];
            Component::new(centre, covariances[k], p / total)
        }));
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        positions.clear();
        draws.clear();
        draws.extend(components.iter().map(|c| c.draw(&mut rng, positions)));
    }
}

/// The binary logarithm of the largest weight of a component.
fn highest_log2_weight(components: &[Component]) -> f32 {
    components.iter().map(Component::log2_weight).fold(f32::NEG_INFINITY, f32::max)
}

/// A Gaussian of the mixture, relative to the truth.
#[derive(Clone, Debug)]
struct Component {
    probability: f32,
    centre: Point,
    /// Lower Cholesky factor (l11, l21, l22) of the covariance.
    factor: [f32; 3],
}

impl Component {
    fn new(centre: Point, [xx, xy, yy]: [f32; 3], probability: f32) -> Self {
        let l11 = xx.max(VARIANCE_MIN_M2).sqrt();
        let l21 = xy / l11;
        let l22 = (yy - l21 * l21).max(VARIANCE_MIN_M2).sqrt();
        Self { probability, centre, factor: [l11, l21, l22] }
    }

    /// Adds draws in proportion to the probability and returns their number.
    ///
    /// Draw j of n is in the j-th of n rings of probability 1/n, a golden section of a turn after the
    /// previous draw. The place within each ring and the first angle are random.
    fn draw(&self, rng: &mut ChaCha8Rng, positions: &mut Positions) -> usize {
        let draw_count = ((self.probability * DRAWS as f32) as usize).max(1);
        let (ring_share, first_turn): (f32, f32) = (rng.random(), rng.random());
        let (mut sin, mut cos) = (first_turn * TAU).sin_cos();
        let (golden_sin, golden_cos) = (GOLDEN * TAU).sin_cos();
        let [l11, l21, l22] = self.factor;
        for ring in 0..draw_count {
            let outside = 1.0 - (ring as f32 + ring_share) / draw_count as f32;
            let radius = (-2.0 * outside.max(f32::EPSILON).ln()).sqrt();
            let (u, v) = (radius * cos, radius * sin);
            positions.push([self.centre[0] + l11 * u, self.centre[1] + l21 * u + l22 * v]);
            (sin, cos) = (sin * golden_cos + cos * golden_sin, cos * golden_cos - sin * golden_sin);
        }
        draw_count
    }

    /// Binary logarithm of the weight p / √|Σ|.
    fn log2_weight(&self) -> f32 {
        (self.probability / (self.factor[0] * self.factor[2])).log2()
    }
}

/// Positions relative to the truth, by axis so that the density vectorises.
#[derive(Clone, Debug, Default)]
struct Positions {
    x: Vec<f32>,
    y: Vec<f32>,
}

impl Positions {
    fn push(&mut self, [x, y]: Point) {
        self.x.push(x);
        self.y.push(y);
    }

    fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
    }

    /// Writes the density at each position, in units of the highest peak of any component.
    fn write_densities(&self, components: &[Component], densities: &mut Vec<f32>) {
        let highest = highest_log2_weight(components);
        densities.clear();
        densities.resize(self.x.len(), 0.0);
        for component in components {
            // e^(−q/2) = 2^(−(a² + b²)) with (a, b) the whitened offset, scaled by √(log₂ e / 2).
            let [l11, l21, l22] = component.factor;
            let scale = (0.5 * LOG2_E).sqrt();
            let (by_x, by_y) = (scale / l11, scale / l22);
            let shear = l21 * by_y / l11;
            let log2_peak = component.log2_weight() - highest;
            let [centre_x, centre_y] = component.centre;
            for ((density, x), y) in densities.iter_mut().zip(&self.x).zip(&self.y) {
                let (dx, dy) = (x - centre_x, y - centre_y);
                let (a, b) = (by_x * dx, by_y * dy - shear * dx);
                *density += exp2(log2_peak - a * a - b * b);
            }
        }
    }
}

/// 2^x for x ≤ 0 with a relative error of 3e-7; 2^−126 for smaller x. The function has no calls or branches,
/// so loops over it vectorise.
fn exp2(x: f32) -> f32 {
    // Taylor coefficients ln(2)ⁿ / n!.
    const C: [f32; 6] = [LN_2, 0.240_226_5, 0.055_504_11, 0.009_618_129, 0.001_333_355_8, 0.000_154_035_3];
    // Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits.
    const ROUND: f32 = 12_582_912.0;
    // Not `max`: NaN must stay NaN.
    let x = if x < -126.0 { -126.0 } else { x };
    let rounded = x + ROUND;
    let f = x - (rounded - ROUND);
    let power = 1.0 + f * (C[0] + f * (C[1] + f * (C[2] + f * (C[3] + f * (C[4] + f * C[5])))));
    f32::from_bits(power.to_bits().wrapping_add(rounded.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};

    const MEANS: [Point; 3] = [[0.0, 0.0], [3.0, 1.0], [1.0, -2.0]];
    const COVARIANCES: [[f32; 3]; 3] = [[1.0, 0.3, 0.5], [0.2, -0.05, 0.4], [2.0, 0.0, 0.1]];
    const PROBABILITY: [f32; 3] = [0.5, 0.15, 0.35];

    fn level(truth: Point, seed: u64) -> f64 {
        highest_density_level(&MEANS, &COVARIANCES, &PROBABILITY, truth, seed)
    }

    /// Density of the mixture in double precision.
    fn density(x: f64, y: f64) -> f64 {
        let component = |k: usize| {
            let [xx, xy, yy] = COVARIANCES[k].map(f64::from);
            let (dx, dy) = (x - f64::from(MEANS[k][0]), y - f64::from(MEANS[k][1]));
            let determinant = xx * yy - xy * xy;
            let squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
            f64::from(PROBABILITY[k]) * (-0.5 * squared).exp() / (std::f64::consts::TAU * determinant.sqrt())
        };
        (0..3).map(component).sum()
    }

    #[test]
    fn levels_equal_an_integral_over_a_fine_grid() {
        const CELL_M: f64 = 0.02;
        let grid: Vec<f64> = (-500..500)
            .flat_map(|i| (-400..400).map(move |j| density(f64::from(i) * CELL_M, f64::from(j) * CELL_M)))
            .collect();
        for truth in [[0.0, 0.0], [3.0, 1.2], [1.5, -0.5], [-1.0, -2.4], [5.0, 2.0], [2.0, 0.2]] {
            let at_truth = density(f64::from(truth[0]), f64::from(truth[1]));
            let mass: f64 = grid.iter().filter(|d| **d > at_truth).sum::<f64>() * CELL_M * CELL_M;
            let levels: Vec<f64> = (0..50).map(|seed| level(truth, seed)).collect();
            let mean = levels.iter().sum::<f64>() / levels.len() as f64;
            assert!((mean - mass).abs() < 0.002, "{truth:?}: {mean}, integral {mass}");
            let worst = levels.iter().map(|l| (l - mass).abs()).fold(0.0, f64::max);
            assert!(worst < 0.015, "{truth:?}: off by {worst}");
        }
    }

    #[test]
    fn areas_equal_those_of_a_fine_grid() {
        const CELL_M: f64 = 0.02;
        let grid = (-500..500)
            .flat_map(|i| (-400..400).map(move |j| density(f64::from(i) * CELL_M, f64::from(j) * CELL_M)));
        let mut densities: Vec<f64> = grid.collect();
        densities.sort_by(|a, b| b.total_cmp(a));
        for level in [0.5, 0.9] {
            let mut mass = 0.0;
            let cells = densities.iter().take_while(|density| {
                mass += **density * CELL_M * CELL_M;
                mass < level
            });
            let expected_m2 = cells.count() as f64 * CELL_M * CELL_M;
            let mut region = HighestDensity::default();
            let mut area_m2 =
                |seed| region.area_m2(&MEANS, &COVARIANCES, &PROBABILITY, level, seed) / expected_m2;
            let areas: Vec<f64> = (0..50).map(&mut area_m2).collect();
            assert!(areas.iter().all(|area| (area - 1.0).abs() < 0.1), "{level}: {areas:?}");
            let mean = areas.iter().sum::<f64>() / areas.len() as f64;
            assert!((mean - 1.0).abs() < 0.01, "{level}: {mean}");
        }
        assert_eq!(HighestDensity::default().area_m2(&[], &[], &[], 0.9, 1), 0.0);
    }

    #[test]
    fn the_area_of_one_gaussian_is_that_of_its_ellipse() {
        let area_m2 = HighestDensity::default().area_m2(&[[50.0, 3.0]], &[[4.0, 1.0, 1.0]], &[0.3], 0.9, 3);
        let expected_m2 = std::f64::consts::PI * -2.0 * 0.1_f64.ln() * 3.0_f64.sqrt();
        assert!((area_m2 / expected_m2 - 1.0).abs() < 0.02, "{area_m2} {expected_m2}");
    }

    #[test]
    fn truths_drawn_from_the_mixture_have_uniform_levels() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut levels: Vec<f64> = (0..4_000)
            .map(|seed| {
                let drawn: f32 = rng.random();
                let k = if drawn < 0.5 {
                    0
                } else if drawn < 0.65 {
                    1
                } else {
                    2
                };
                let [l11, l21, l22] = Component::new(MEANS[k], COVARIANCES[k], 1.0).factor;
                let (u, v): (f32, f32) = (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
                level([MEANS[k][0] + l11 * u, MEANS[k][1] + l21 * u + l22 * v], seed)
            })
            .collect();
        levels.sort_by(f64::total_cmp);
        // Kolmogorov-Smirnov distance; chance exceeds 1.63 / √n for one seed in a hundred.
        let n = levels.len() as f64;
        let distance =
            levels.iter().enumerate().map(|(i, l)| (l - (i as f64 + 0.5) / n).abs()).fold(0.0, f64::max);
        assert!(distance < 1.63 / n.sqrt(), "{distance}");
    }

    #[test]
    fn levels_repeat_by_seed() {
        assert_eq!(level([1.5, -0.5], 3), level([1.5, -0.5], 3));
        assert!((0..9).any(|seed| level([1.5, -0.5], seed) != level([1.5, -0.5], 9)));
    }

    #[test]
    fn mixtures_without_probability_have_level_1() {
        assert_eq!(highest_density_level(&[], &[], &[], [0.0; 2], 1), 1.0);
        assert_eq!(highest_density_level(&[[0.0; 2]], &[[1.0, 0.0, 1.0]], &[0.0], [0.0; 2], 1), 1.0);
        assert_eq!(highest_density_level(&[[f32::NAN; 2]], &[[1.0, 0.0, 1.0]], &[1.0], [0.0; 2], 1), 1.0);
        assert_eq!(highest_density_level(&[[0.0; 2]], &[[1.0, 0.0, 1.0]], &[1.0], [f32::NAN; 2], 1), 1.0);
    }

    #[test]
    fn a_zero_covariance_has_the_least_variance() {
        let certain = |truth| highest_density_level(&[[4.0, 4.0]], &[[0.0; 3]], &[1.0], truth, 1);
        assert!(certain([4.005, 4.0]) < 0.5);
        assert_eq!(certain([4.1, 4.0]), 1.0);
    }

    #[test]
    fn components_of_probability_0_change_nothing() {
        let covariances = [[1.0, 0.0, 1.0]; 2];
        let both = highest_density_level(&[[0.0; 2], [1.0, 0.0]], &covariances, &[1.0, 0.0], [1.0, 0.0], 4);
        let alone = highest_density_level(&[[0.0; 2]], &covariances[..1], &[1.0], [1.0, 0.0], 4);
        assert_eq!(both, alone);
    }

    #[test]
    fn exp2_is_exact_to_rounding() {
        for i in 0..=12_600 {
            let x = -0.01 * i as f32;
            let exact = f64::from(x).exp2();
            assert!((f64::from(exp2(x)) / exact - 1.0).abs() < 3e-7, "{x}");
        }
        assert_eq!(exp2(-1e9), f32::MIN_POSITIVE);
        assert!(exp2(f32::NAN).is_nan());
    }

    proptest! {
        #[test]
        fn level_of_one_gaussian_is_that_of_its_ellipse(
            mean in [-50.0f32..50.0, -50.0f32..50.0], l11 in 0.05f32..5.0, l21 in -3.0f32..3.0, l22 in 0.05f32..5.0,
            u in -3.0f32..3.0, v in -3.0f32..3.0, weight in 0.1f32..3.0, seed in 0u64..1_000,
        ) {
            let covariance = [l11 * l11, l11 * l21, l21 * l21 + l22 * l22];
            let truth = [mean[0] + l11 * u, mean[1] + l21 * u + l22 * v];
            let level = highest_density_level(&[mean], &[covariance], &[weight], truth, seed);
            let exact = 1.0 - f64::from(-0.5 * (u * u + v * v)).exp();
            prop_assert!((level - exact).abs() < 1.5 / DRAWS as f64, "{level} {exact}");
        }

        #[test]
        fn scaling_all_probabilities_changes_nothing(x in -4.0f32..6.0, y in -4.0f32..4.0) {
            let doubled = PROBABILITY.map(|p| 2.0 * p);
            prop_assert_eq!(
                highest_density_level(&MEANS, &COVARIANCES, &doubled, [x, y], 1),
                level([x, y], 1)
            );
        }
    }
}
