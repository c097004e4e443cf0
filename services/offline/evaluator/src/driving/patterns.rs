//! Typical residuals of several sources together, by k-medians. The fan of modes starts from them.

use evidence::{BANDS, Context, FAN, KNOTS, OUTLIER, Pattern, Patterns, fill_unknown};
use scene::AgentType;
use wire::{AGENT_TYPES, MODES_MAX};

use super::Sample;

/// Positions at the knots along and across the course.
type Knots = [[f32; 2]; KNOTS];

/// Minimum number of residuals that a source needs at a speed to contribute to a pattern.
const RESIDUALS_MIN: usize = 60;
/// Maximum number of residuals used per source and speed, spread evenly over all.
const RESIDUALS_MAX: usize = 400;
/// Minimum deviation of residuals, m.
const DEVIATION_MIN_M: f32 = 0.02;
/// Weight of the residuals of the next slower and next faster band, relative to the band itself.
const NEIGHBOUR_SHARE: f32 = 0.3;
/// Minimum number of sources in a pattern. The default fan stands in for missing sources.
const SOURCES_MIN: usize = 5;
/// Passes of the robust deviations. Each pass clamps outliers more tightly.
const DEVIATION_PASSES: usize = 12;
/// Steps of the k-medians descent.
const STEPS: usize = 30;
/// Random starts of the descent; the best result counts.
const STARTS: u64 = 8;

/// What the truth was beside the middle of a forecast's fan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Residual {
    pub(crate) agent_type: AgentType,
    pub(crate) speed_mps: f32,
    /// Along and across the course, m.
    pub(crate) residuals_m: Knots,
}

/// The residuals of one source in units of their deviations, by type.
pub(crate) struct Residuals([Units; AGENT_TYPES.len()]);

/// The residuals of one source and type in units of their deviations.
struct Units {
    /// By speed band; `None` if there are too few residuals.
    deviations_m: [Option<Knots>; BANDS],
    residuals: [Vec<Knots>; BANDS],
}

/// Residuals with their weights.
#[derive(Default)]
struct Weighted {
    residuals: Vec<Knots>,
    weights: Vec<f32>,
}

/// The result of k-medians.
struct Medians {
    points_m: [Knots; MODES_MAX],
    /// Total weight of the residuals whose nearest point this is.
    weights: [f32; MODES_MAX],
    /// Weighted sum of the residuals' distances to their nearest points.
    missed_m: f32,
}

/// The patterns of all these sources together, for each type that at least one source has.
pub(crate) fn patterns(sources: &[&Residuals]) -> Patterns {
    let mut patterns = Patterns::default();
    for (place, of_type) in patterns.iter_mut().enumerate() {
        let units: Vec<&Units> = sources.iter().map(|Residuals(of_source)| &of_source[place]).collect();
        let known = std::array::from_fn(|band| units.iter().any(|units| units.deviations_m[band].is_some()));
        for band in (0..BANDS).filter(|&band| known[band]) {
            of_type[band] = together(&units, band);
        }
        fill_unknown(of_type, &known);
    }
    patterns
}

impl Residuals {
    /// The residuals of a source's forecasts.
    pub(crate) fn of(residuals: &[Residual]) -> Self {
        Self(AGENT_TYPES.map(|agent_type| Units::of(residuals, agent_type)))
    }

    /// The residuals of a source's samples.
    pub(crate) fn of_samples(samples: &[Sample]) -> Self {
        Self::of(&samples.iter().map(Residual::of).collect::<Vec<_>>())
    }
}

impl Residual {
    const fn of(sample: &Sample) -> Self {
        let Sample { agent_type, speed_mps, residuals_m, .. } = *sample;
        Self { agent_type, speed_mps, residuals_m }
    }
}

impl Units {
    fn of(residuals: &[Residual], agent_type: AgentType) -> Self {
        let mut metres: [Vec<(Context, Knots)>; BANDS] = Default::default();
        for residual in residuals.iter().filter(|residual| residual.agent_type == agent_type) {
            let context = Context::new(agent_type, residual.speed_mps);
            metres[context.nearest()].push((context, residual.residuals_m));
        }
        let deviations_m =
            metres.each_ref().map(|of_band| (of_band.len() >= RESIDUALS_MIN).then(|| deviations_m(of_band)));
        let residuals = std::array::from_fn(|band| {
            let (of_band, Some(own_m)) = (&metres[band], deviations_m[band]) else { return Vec::new() };
            let stride = of_band.len().div_ceil(RESIDUALS_MAX);
            let units = of_band.iter().step_by(stride).map(|(context, residual_m)| {
                let bands = context.bands().map(|(band, share)| (deviations_m[band].unwrap_or(own_m), share));
                let deviation_m = |knot: usize, axis: usize| {
                    bands.iter().map(|(of_band_m, share)| share * of_band_m[knot][axis]).sum::<f32>()
                };
                knots(|knot, axis| {
                    (residual_m[knot][axis] / deviation_m(knot, axis)).clamp(-OUTLIER, OUTLIER)
                })
            });
            // Mirrored, so that patterns are symmetric to the left and right.
            units.flat_map(|unit| [unit, unit.map(|[along, across]| [along, -across])]).collect()
        });
        Self { deviations_m, residuals }
    }
}

/// Root mean squares at the knots, of residuals clamped to [`OUTLIER`] deviations.
fn deviations_m(residuals_m: &[(Context, Knots)]) -> Knots {
    let mut most_m = [[f32::INFINITY; 2]; KNOTS];
    let mut deviations_m = most_m;
    for _ in 0..DEVIATION_PASSES {
        deviations_m = knots(|knot, axis| {
            let most_m = most_m[knot][axis];
            let squares = residuals_m
                .iter()
                .map(|(_, residual_m)| residual_m[knot][axis].clamp(-most_m, most_m).powi(2));
            let sum: f64 = squares.map(f64::from).sum();
            ((sum / residuals_m.len().max(1) as f64).sqrt() as f32).max(DEVIATION_MIN_M)
        });
        most_m = deviations_m.map(|of_knot| of_knot.map(|deviation_m| OUTLIER * deviation_m));
    }
    deviations_m
}

/// The pattern at a speed, over all sources that have it: k-medians of their residuals. Each source has the
/// same weight.
fn together(sources: &[&Units], band: usize) -> Pattern {
    let deviations_m: Vec<Knots> = sources.iter().filter_map(|source| source.deviations_m[band]).collect();
    // Along and across have different units. Distances are in metres, by the sources' typical deviations.
    let typical_m = knots(|knot, axis| {
        let logs: f32 = deviations_m.iter().map(|deviation_m| deviation_m[knot][axis].ln()).sum();
        (logs / deviations_m.len() as f32).exp()
    });
    let mut all = Weighted::default();
    for (other, share) in [(band.wrapping_sub(1), NEIGHBOUR_SHARE), (band, 1.0), (band + 1, NEIGHBOUR_SHARE)]
    {
        for of_source in sources.iter().filter_map(|source| source.residuals.get(other)) {
            let weight = share / of_source.len().max(1) as f32;
            of_source.iter().for_each(|residual| all.push(*residual, weight));
        }
    }
    let lacking = SOURCES_MIN.saturating_sub(deviations_m.len()) as f32;
    if lacking > 0.0 {
        FAN.iter().for_each(|&(point, p)| all.push([point; KNOTS], lacking * p));
    }
    all.medians(&typical_m)
}

impl Weighted {
    fn push(&mut self, residual: Knots, weight: f32) {
        self.residuals.push(residual);
        self.weights.push(weight);
    }

    /// Twenty points that are medians of the residuals, by distance in metres.
    fn medians(&self, typical_m: &Knots) -> Pattern {
        let in_metres = |unit: &Knots| knots(|knot, axis| unit[knot][axis] * typical_m[knot][axis]);
        let places_m: Vec<Knots> = self.residuals.iter().map(in_metres).collect();
        let found = |seed| self.descend(&places_m, self.start(&places_m, seed));
        let least = |one: Medians, other: Medians| if other.missed_m < one.missed_m { other } else { one };
        let Medians { points_m, weights, .. } = (2..=STARTS).map(found).fold(found(1), least);
        let sum: f32 = weights.iter().sum();
        Pattern {
            points: points_m.map(|point_m| knots(|knot, axis| point_m[knot][axis] / typical_m[knot][axis])),
            probability: weights.map(|weight| weight / sum),
        }
    }

    /// Starting points by [k-means++](https://dl.acm.org/doi/10.5555/1283383.1283494): the probability of a
    /// point is proportional to its distance from the points already chosen.
    fn start(&self, places_m: &[Knots], seed: u64) -> [Knots; MODES_MAX] {
        let mut random = seed;
        let mut points_m = [[[0.0; 2]; KNOTS]; MODES_MAX];
        let mut chances = self.weights.clone();
        let mut nearest_m = vec![f32::INFINITY; places_m.len()];
        for point_m in &mut points_m {
            // Knuth's constants (MMIX). Only the high bits are random enough.
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mut left = (random >> 40) as f32 / (1_u64 << 24) as f32 * chances.iter().sum::<f32>();
            let place = chances.iter().position(|chance| {
                left -= chance;
                left < 0.0
            });
            *point_m = places_m[place.unwrap_or(0)];
            for (place_m, (nearest_m, (chance, weight))) in
                places_m.iter().zip(nearest_m.iter_mut().zip(chances.iter_mut().zip(&self.weights)))
            {
                *nearest_m = nearest_m.min(distance_m(place_m, point_m));
                *chance = weight * *nearest_m;
            }
        }
        points_m
    }

    /// Moves each point to the median of the residuals nearest to it, in [`STEPS`] steps.
    fn descend(&self, places_m: &[Knots], points_m: [Knots; MODES_MAX]) -> Medians {
        let mut medians = Medians { points_m, weights: [0.0; MODES_MAX], missed_m: 0.0 };
        let Medians { points_m, weights, missed_m } = &mut medians;
        for _ in 0..STEPS {
            (*weights, *missed_m) = ([0.0; MODES_MAX], 0.0);
            // Weiszfeld's step at each knot: sums of position / distance, and of 1 / distance.
            let mut sums = [[[0.0_f32; 3]; KNOTS]; MODES_MAX];
            for (place_m, weight) in places_m.iter().zip(&self.weights) {
                let distances_m = points_m.iter().map(|point_m| distance_m(place_m, point_m)).enumerate();
                let Some((nearest, apart_m)) = distances_m.min_by(|a, b| a.1.total_cmp(&b.1)) else {
                    continue;
                };
                *missed_m += weight * apart_m;
                weights[nearest] += weight;
                for ((sums, [x, y]), [px, py]) in
                    sums[nearest].iter_mut().zip(place_m).zip(&points_m[nearest])
                {
                    let by = weight / (x - px).hypot(y - py).max(DEVIATION_MIN_M);
                    *sums = [sums[0] + by * x, sums[1] + by * y, sums[2] + by];
                }
            }
            for (point_m, sums) in points_m.iter_mut().zip(&sums).filter(|(_, sums)| sums[0][2] > 0.0) {
                *point_m = sums.map(|[x, y, of]| [x / of, y / of]);
            }
        }
        medians
    }
}

/// Sum of the distances at the knots.
fn distance_m(one: &Knots, other: &Knots) -> f32 {
    let squares =
        one.iter().zip(other).map(|([x, y], [ox, oy])| ((x - ox) * (x - ox) + (y - oy) * (y - oy)).sqrt());
    squares.sum()
}

fn knots(of: impl Fn(usize, usize) -> f32) -> Knots {
    std::array::from_fn(|knot| std::array::from_fn(|axis| of(knot, axis)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn residuals(samples: &[Sample]) -> Vec<Residual> {
        samples.iter().map(Residual::of).collect()
    }

    /// Vehicles at 6 m/s with each of these residuals equally often, `scale` times as large.
    fn source(residuals_m: &[[f32; 2]], scale: f32) -> Vec<Sample> {
        let of = |residual_m: [f32; 2], number: usize| {
            // Residuals are never exactly equal.
            let more = 1.0 + 0.01 * (number % 7) as f32;
            let residuals_m = [0.1, 0.3, 0.5, 1.0].map(|share| residual_m.map(|x| scale * share * more * x));
            Sample { residuals_m, ..Sample::of(AgentType::Vehicle, 6.0) }
        };
        (0..100)
            .flat_map(|number| residuals_m.iter().map(move |residual_m| of(*residual_m, number)))
            .collect()
    }

    #[test]
    fn a_pattern_has_what_agents_do_in_units_of_how_far_they_deviate() {
        let sources =
            [1.0, 3.0, 5.0, 0.5, 2.0].map(|scale| source(&[[0.0, 0.0], [4.0, 0.0], [-8.0, 2.0]], scale));
        let sources = sources.map(|samples| Residuals::of_samples(&samples));
        let patterns = patterns(&sources.each_ref());
        let Pattern { points, probability } = patterns[AgentType::Vehicle.index()][2];
        // Root mean squares at the end for scale 1: 5.3 m along and 1.2 m across.
        for [along, across] in [[0.0, 0.0], [0.76, 0.0], [-1.5, 1.7], [-1.5, -1.7]] {
            let near = |point: &Knots| (point[3][0] - along).hypot(point[3][1] - across) < 0.15;
            let p: f32 =
                points.iter().zip(probability).filter(|(point, _)| near(point)).map(|(_, p)| p).sum();
            assert!(p > if across == 0.0 { 0.3 } else { 0.15 }, "{along} {across}: {p} of {points:?}");
        }
        assert!((probability.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        // A speed without residuals takes the nearest speed that has some. A type without residuals keeps the
        // default.
        assert_eq!(patterns[AgentType::Vehicle.index()][5], patterns[AgentType::Vehicle.index()][2]);
        assert_eq!(patterns[AgentType::Cyclist.index()], Patterns::default()[AgentType::Cyclist.index()]);
    }

    #[test]
    fn a_jump_does_not_make_all_else_small_and_few_residuals_make_no_pattern() {
        let mut samples = source(&[[2.0, 0.0], [-2.0, 0.0]], 1.0);
        samples[0].residuals_m = [[1e4, 1e4]; KNOTS];
        let Units { deviations_m, residuals: units } = Units::of(&residuals(&samples), AgentType::Vehicle);
        let along_m = deviations_m[2].expect("enough")[3][0];
        assert!((1.9..3.0).contains(&along_m), "{along_m}");
        assert!(units[2].as_flattened().as_flattened().iter().all(|unit| unit.abs() <= OUTLIER));
        assert!(deviations_m[1].is_none() && units[1].is_empty());
        samples.truncate(RESIDUALS_MIN - 1);
        assert!(Units::of(&residuals(&samples), AgentType::Vehicle).deviations_m[2].is_none());
    }
}
