//! A reference for the size of the published regions: regions about constant velocity that hold the same
//! number of truths.

use super::{Gaussian, STEPS, Sample};

/// A speed band with fewer forecasts uses the Gaussian of all forecasts.
const BAND_MIN: usize = 20;

/// Mean area of the regions at the end of the horizon, m². In each speed band, they hold the same number of
/// truths as the published regions of this level.
///
/// The regions are ellipses of a Gaussian. It models the truth's residual to constant velocity, along and
/// across the course. For each band the Gaussian is fitted in hindsight to the band's forecasts. It is then
/// scaled until it holds that number of truths.
pub(crate) fn mean_area_m2(
    samples: &[&Sample],
    level: f64,
    band_of: impl Fn(&Sample) -> usize,
    band_count: usize,
) -> f64 {
    let fit = |samples: &[&Sample]| {
        Gaussian::fit(&samples.iter().map(|sample| sample.beyond_steady_m).collect::<Vec<_>>())
    };
    let sums_m2 = (0..band_count).map(|band| {
        let of_band: Vec<&Sample> = samples.iter().copied().filter(|s| band_of(s) == band).collect();
        let gaussian = fit(if of_band.len() < BAND_MIN { samples } else { &of_band });
        let held = of_band.iter().filter(|sample| sample.is_held(level, STEPS.len() - 1)).count();
        let mut squares: Vec<f64> =
            of_band.iter().map(|sample| gaussian.square(sample.beyond_steady_m)).collect();
        squares.sort_by(f64::total_cmp);
        let square = held.checked_sub(1).map_or(0.0, |last| squares[last]);
        square * gaussian.area_m2() * of_band.len() as f64
    });
    sums_m2.sum::<f64>() / samples.len() as f64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use scene::AgentType;

    use super::*;

    /// 200 forecasts at each of two speeds. The truths of one speed are inside a circle of this radius about
    /// a point. The regions hold the first `held` of them.
    fn samples(radii_m: [f32; 2], held: [usize; 2]) -> Vec<Sample> {
        let of = |number: usize| {
            let (fast, angle) = (number % 2, 0.1 * number as f32);
            let radius_m = radii_m[fast] * (0.5 + 0.5 * (0.618 * number as f32).fract());
            Sample {
                beyond_steady_m: [1.0 + radius_m * angle.cos(), radius_m * angle.sin()],
                levels: [if number / 2 < held[fast] { 0.5 } else { 0.95 }; STEPS.len()],
                ..Sample::of(AgentType::Vehicle, 10.0 * fast as f32)
            }
        };
        (0..400).map(of).collect()
    }

    fn area_m2(held: [usize; 2], band_count: usize) -> f64 {
        let samples = samples([1.0, 10.0], held);
        let samples: Vec<&Sample> = samples.iter().collect();
        let band_of = |sample: &Sample| usize::from(band_count > 1 && sample.speed_mps > 5.0);
        mean_area_m2(&samples, 0.9, band_of, band_count)
    }

    #[test]
    fn a_region_of_all_is_the_circle_and_speeds_have_their_own() {
        let apart_m2 = area_m2([200, 200], 2);
        assert!((apart_m2 / (PI * 50.5) - 1.0).abs() < 0.05, "{apart_m2}");
        let together_m2 = area_m2([200, 200], 1);
        assert!((together_m2 / (PI * 100.0) - 1.0).abs() < 0.1, "{together_m2}");
        // Half of the truths are within three quarters of the radius.
        let half_m2 = area_m2([100, 100], 2);
        assert!((half_m2 / (PI * 50.5 * 0.5625) - 1.0).abs() < 0.05, "{half_m2}");
        assert_eq!(area_m2([0, 0], 2), 0.0);
    }

    #[test]
    fn a_speed_whose_truths_are_held_makes_up_for_no_other() {
        let [slow_m2, fast_m2] = [[200, 0], [0, 200]].map(|held| area_m2(held, 2));
        assert!((slow_m2 / (PI * 0.5) - 1.0).abs() < 0.05, "{slow_m2}");
        assert!((fast_m2 / (PI * 50.0) - 1.0).abs() < 0.05, "{fast_m2}");
    }
}
