//! How large a region about constant velocity must be to hold as many truths: the yardstick of the published regions.

use crate::gaussian::Gaussian;
use crate::sample::Sample;

/// A speed band of fewer forecasts has the Gaussian of all.
const BAND_MIN: usize = 20;

/// Mean area of regions at the end of the horizon that hold this share of the truths, m².
///
/// They are ellipses of a Gaussian of what the truth is beyond constant velocity, along and across the course. It is
/// fitted in hindsight to the same forecasts, to those of each speed band apart, and all ellipses are scaled
/// alike until they hold the share.
pub(crate) fn mean_area_m2(
    samples: &[&Sample],
    share: f64,
    band_of: impl Fn(&Sample) -> usize,
    bands_len: usize,
) -> f64 {
    let fit = |samples: &[&Sample]| {
        Gaussian::fit(&samples.iter().map(|sample| sample.beyond_steady_m).collect::<Vec<_>>())
    };
    let of_all = fit(samples);
    let of_bands: Vec<Gaussian> = (0..bands_len)
        .map(|band| {
            let of_band: Vec<&Sample> = samples.iter().copied().filter(|s| band_of(s) == band).collect();
            if of_band.len() < BAND_MIN { of_all } else { fit(&of_band) }
        })
        .collect();
    let gaussians = samples.iter().map(|sample| (sample, &of_bands[band_of(sample)]));
    let (mut squares, areas_m2): (Vec<f64>, Vec<f64>) = gaussians
        .map(|(sample, gaussian)| (gaussian.square(sample.beyond_steady_m), gaussian.area_m2()))
        .unzip();
    squares.sort_by(f64::total_cmp);
    let held = (share * squares.len() as f64).ceil() as usize;
    let Some(square) = held.checked_sub(1).and_then(|last| squares.get(last)) else { return 0.0 };
    square * areas_m2.iter().sum::<f64>() / areas_m2.len() as f64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use scene::AgentType;

    use super::*;

    /// Forecasts of two speeds, whose truths lie on circles of these radii about a point.
    fn samples(radii_m: [f32; 2]) -> Vec<Sample> {
        let of = |number: usize| {
            let (fast, angle) = (number % 2, 0.1 * number as f32);
            let radius_m = radii_m[fast] * (0.5 + 0.5 * (0.618 * number as f32).fract());
            Sample {
                beyond_steady_m: [1.0 + radius_m * angle.cos(), radius_m * angle.sin()],
                ..Sample::of(AgentType::Vehicle, 10.0 * fast as f32)
            }
        };
        (0..400).map(of).collect()
    }

    #[test]
    fn a_region_of_all_is_the_circle_and_speeds_have_their_own() {
        let samples = samples([1.0, 10.0]);
        let samples: Vec<&Sample> = samples.iter().collect();
        let by_speed = |sample: &Sample| usize::from(sample.speed_mps > 5.0);
        let apart_m2 = mean_area_m2(&samples, 1.0, by_speed, 2);
        assert!((apart_m2 / (PI * 50.5) - 1.0).abs() < 0.05, "{apart_m2}");
        let together_m2 = mean_area_m2(&samples, 1.0, |_| 0, 1);
        assert!((together_m2 / (PI * 100.0) - 1.0).abs() < 0.1, "{together_m2}");
        // Half of them lie within three quarters of the radius.
        let half_m2 = mean_area_m2(&samples, 0.5, by_speed, 2);
        assert!((half_m2 / (PI * 50.5 * 0.5625) - 1.0).abs() < 0.05, "{half_m2}");
        assert_eq!(mean_area_m2(&samples, 0.0, by_speed, 2), 0.0);
    }
}
