//! Tunes each method's setting by the likelihood of measurements, with the same number of trials for all
//! methods.

use super::{Course, Follower, Outcome, Setting, Settings, TrackingMethod};
use crate::forecaster::Forecaster;
use crate::threads;

/// Number of settings that each method may try.
pub(crate) const TRIALS: usize = 36;
/// Factors by which a number is changed. The next one is used when neither direction improves.
const FACTORS: [f64; 2] = [2.0, std::f64::consts::SQRT_2];

/// The result of tuning.
#[derive(Clone, Debug)]
pub(crate) struct Trials {
    /// The best settings of all methods.
    pub(crate) settings: Settings,
    /// Mean negative log-likelihood of a measured position, by method.
    pub(crate) figures: Vec<(TrackingMethod, f64)>,
}

/// Tunes methods on courses with the same noise.
///
/// The Singer bicycle must precede the learned prior, which contains it.
pub(crate) fn tune(
    courses: &[Course<'_>],
    forecaster: &Forecaster,
    methods: &[TrackingMethod],
    threads: usize,
) -> Trials {
    let mut settings = Settings::first();
    let mut figures = Vec::new();
    for &method in methods {
        let nll = |setting: Setting| {
            let settings = settings.with(method, setting);
            let follow =
                |course: &Course<'_>, (): &mut ()| Follower { method, settings, forecaster }.follow(course);
            let outcomes = threads::each(courses, threads, follow);
            Outcome::nll(&outcomes)
        };
        let (setting, figure) = search(method.first_setting(), method.tuned().len(), nll);
        settings = settings.with(method, setting);
        figures.push((method, figure));
    }
    Trials { settings, figures }
}

/// Changes one number after the other, by decreasing factors, as long as the likelihood improves.
fn search(first: Setting, axes: usize, mut nll: impl FnMut(Setting) -> f64) -> (Setting, f64) {
    let mut best = (first, nll(first));
    let mut left = TRIALS - 1;
    for factor in FACTORS {
        let mut improved = true;
        while improved {
            improved = false;
            for (axis, change) in (0..axes).flat_map(|axis| [(axis, factor), (axis, 1.0 / factor)]) {
                if left == 0 {
                    return best;
                }
                let mut setting = best.0;
                setting[axis] *= change;
                left -= 1;
                let figure = nll(setting);
                if figure < best.1 {
                    best = (setting, figure);
                    improved = true;
                }
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn search_comes_near_the_optimum_within_its_trials() {
        let mut trial_count = 0;
        let (found, figure) = search([1.0; 3], 2, |[a, b, _]| {
            trial_count += 1;
            (a / 6.0).ln().powi(2) + (b / 0.3).ln().powi(2)
        });
        assert!(trial_count <= TRIALS);
        assert!((found[0] / 6.0).ln().abs() < 0.5 && (found[1] / 0.3).ln().abs() < 0.5, "{found:?}");
        assert!(figure < 0.4);
        let (same, _) = search([2.0, 7.0, 7.0], 1, |[a, ..]| (a - 2.0).abs());
        assert_eq!(same, [2.0, 7.0, 7.0]);
    }
}
