//! Confidence intervals of differences between two forecasters, by the paired cluster bootstrap.
//!
//! The errors of agents in one window are correlated, and so are the errors of windows in one recording. The
//! agents are therefore not independent samples. The bootstrap resamples whole *clusters* (windows or
//! recordings) with replacement and compares the two forecasters on the same clusters. Each resample has the
//! original number of clusters. The interval contains 95 % of the resamples.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The errors of two forecasters on one cluster of agents.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairedErrors {
    /// Sum of our errors.
    pub ours: f64,
    /// Sum of the other forecaster's errors on the same agents.
    pub theirs: f64,
    /// Number of errors in each sum.
    pub len: u64,
}

impl PairedErrors {
    /// Counts both errors on one agent.
    pub fn add(&mut self, ours: f64, theirs: f64) {
        self.merge(&Self { ours, theirs, len: 1 });
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.ours += other.ours;
        self.theirs += other.theirs;
        self.len += other.len;
    }
}

/// A figure and its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end: 2.5 % of the resamples are below.
    pub low: f64,
    /// The figure over all clusters.
    pub mean: f64,
    /// Upper end: 2.5 % of the resamples are above.
    pub high: f64,
}

/// Our mean error minus theirs, over all agents.
///
/// Below 0 our error is smaller. The difference is significant if the whole interval is below 0. Returns
/// `None` if no cluster has an error or `resamples` is 0. The same seed gives the same interval. Cost:
/// clusters × resamples.
#[must_use]
pub fn paired_bootstrap(clusters: &[PairedErrors], resamples: usize, seed: u64) -> Option<Interval> {
    bootstrap(clusters, resamples, seed, |sum| (sum.ours - sum.theirs) / sum.len as f64)
}

/// Our mean error divided by theirs: below 1 our error is smaller.
///
/// Otherwise like [`paired_bootstrap`]; also `None` if all of their errors are 0.
#[must_use]
pub fn paired_bootstrap_ratio(clusters: &[PairedErrors], resamples: usize, seed: u64) -> Option<Interval> {
    bootstrap(clusters, resamples, seed, |sum| sum.ours / sum.theirs).filter(|ratio| ratio.mean.is_finite())
}

fn bootstrap(
    clusters: &[PairedErrors],
    resamples: usize,
    seed: u64,
    figure: impl Fn(&PairedErrors) -> f64,
) -> Option<Interval> {
    // Empty clusters have no error, and a resample of only empty clusters would have no mean.
    let clusters: Vec<PairedErrors> = clusters.iter().filter(|cluster| cluster.len > 0).copied().collect();
    cluster_bootstrap(clusters.len(), resamples, seed, |drawn| {
        let sum = drawn.iter().fold(PairedErrors::default(), |mut sum, &cluster| {
            sum.merge(&clusters[cluster]);
            sum
        });
        Some(figure(&sum))
    })
}

/// The interval of any figure. `figure` computes it for the clusters with the given numbers, or returns
/// `None` if these clusters have no figure.
///
/// Returns `None` if all clusters together have no figure, or if no resample has one. Otherwise like
/// [`paired_bootstrap`].
#[must_use]
pub fn cluster_bootstrap(
    cluster_count: usize,
    resamples: usize,
    seed: u64,
    figure: impl Fn(&[usize]) -> Option<f64>,
) -> Option<Interval> {
    if cluster_count == 0 {
        return None;
    }
    let all: Vec<usize> = (0..cluster_count).collect();
    let mean = figure(&all)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = all;
    let mut resample = || {
        drawn.fill_with(|| rng.random_range(0..cluster_count));
        figure(&drawn)
    };
    let mut figures: Vec<f64> = (0..resamples).filter_map(|_| resample()).collect();
    figures.sort_by(f64::total_cmp);
    (!figures.is_empty()).then(|| Interval {
        low: quantile(&figures, 0.025),
        mean,
        high: quantile(&figures, 0.975),
    })
}

/// A quantile of sorted values, interpolated linearly.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    below + (above - below) * place.fract()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Clusters of three agents that share a difference of N(−0.1, 0.2²).
    fn clusters(len: usize, seed: u64) -> Vec<PairedErrors> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut cluster = || {
            let mut errors = PairedErrors::default();
            let noise: f64 = StandardNormal.sample(&mut rng);
            let theirs = 1.0 + rng.random::<f64>();
            (0..3).for_each(|_| errors.add(theirs - 0.1 + 0.2 * noise, theirs));
            errors
        };
        (0..len).map(|_| cluster()).collect()
    }

    #[test]
    fn interval_width_equals_the_clusters_standard_error() {
        let clusters = clusters(400, 1);
        let found = paired_bootstrap(&clusters, 4_000, 2).expect("clusters");
        let differences: Vec<f64> = clusters.iter().map(|c| (c.ours - c.theirs) / 3.0).collect();
        let mean = differences.iter().sum::<f64>() / 400.0;
        let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / 400.0;
        let half = 1.96 * (variance / 400.0).sqrt();
        assert!((found.mean - mean).abs() < 1e-12);
        assert!((found.low - (mean - half)).abs() < 0.1 * half, "{found:?}, {half}");
        assert!((found.high - (mean + half)).abs() < 0.1 * half, "{found:?}, {half}");
    }

    #[test]
    fn intervals_cover_the_truth_in_95_percent() {
        let holds = |seed: &u64| {
            let found = paired_bootstrap(&clusters(60, *seed), 400, 3).expect("clusters");
            found.low <= -0.1 && -0.1 <= found.high
        };
        let held = (0..400).filter(holds).count();
        assert!((360..=392).contains(&held), "{held} of 400");
    }

    #[test]
    fn clusters_weigh_by_their_number_of_errors() {
        let clusters = [
            PairedErrors { ours: 1.0, theirs: 2.0, len: 1 },
            PairedErrors { ours: 9.0, theirs: 6.0, len: 3 },
        ];
        assert_eq!(paired_bootstrap(&clusters, 100, 1).map(|i| i.mean), Some(0.5));
        assert_eq!(paired_bootstrap_ratio(&clusters, 100, 1).map(|i| i.mean), Some(1.25));
    }

    #[test]
    fn ratio_of_proportional_errors_has_no_spread() {
        let halved: Vec<PairedErrors> =
            clusters(20, 4).iter().map(|c| PairedErrors { ours: 0.5 * c.theirs, ..*c }).collect();
        let found = paired_bootstrap_ratio(&halved, 50, 1).expect("clusters");
        assert!((found.low - 0.5).abs() < 1e-12 && (found.high - 0.5).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn intervals_repeat_by_seed() {
        let clusters = clusters(30, 5);
        assert_eq!(paired_bootstrap(&clusters, 100, 1), paired_bootstrap(&clusters, 100, 1));
        assert_ne!(paired_bootstrap(&clusters, 100, 1), paired_bootstrap(&clusters, 100, 2));
    }

    #[test]
    fn no_errors_have_no_interval() {
        assert_eq!(paired_bootstrap(&[], 100, 1), None);
        assert_eq!(paired_bootstrap(&[PairedErrors::default(); 3], 100, 1), None);
        assert_eq!(paired_bootstrap(&clusters(3, 1), 0, 1), None);
        let flawless = [PairedErrors { ours: 1.0, theirs: 0.0, len: 1 }];
        assert_eq!(paired_bootstrap_ratio(&flawless, 100, 1), None);
    }

    #[test]
    fn resamples_without_a_figure_are_left_out() {
        let values = [1.0, 2.0, 6.0];
        let mean = |drawn: &[usize]| Some(drawn.iter().map(|&i| values[i]).sum::<f64>() / drawn.len() as f64);
        // One draw of 27 has the last cluster alone, one the first: more than a quantile of 2.5 %.
        let found = cluster_bootstrap(3, 5000, 1, mean).expect("clusters");
        assert_eq!((found.mean, found.low, found.high), (3.0, 1.0, 6.0));
        let with_the_last = |drawn: &[usize]| drawn.contains(&2).then_some(1.0);
        assert_eq!(cluster_bootstrap(3, 500, 1, with_the_last).map(|i| i.low), Some(1.0));
        assert_eq!(cluster_bootstrap(3, 500, 1, |_| None), None);
    }

    #[test]
    fn quantiles_equal_values_by_hand() {
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.5), 2.0);
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), 3.0);
        assert_eq!(quantile(&[7.0], 0.975), 7.0);
    }
}
