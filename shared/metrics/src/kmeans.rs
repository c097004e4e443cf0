//! Lloyd's k-means with k-means++ seeding.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The result of [`kmeans`].
#[derive(Clone, Debug, PartialEq)]
pub struct Clusters {
    /// Centres, `clusters × dimension`, row by row.
    pub centres: Vec<f32>,
    /// The cluster of each point.
    pub labels: Vec<u32>,
    /// Points in each cluster.
    pub sizes: Vec<usize>,
    /// Sum of the squared distances between points and their centres.
    pub inertia: f64,
}

/// Splits `points` (rows of `dimension` numbers) into `clusters` groups around their means.
///
/// 1. Draw the first centres with `seed`, with a probability proportional to the squared distance from the
///    centres drawn before (k-means++).
/// 2. Assign each point to its nearest centre and move each centre to the mean of its points. Repeat this at
///    most `iterations` times, or until nothing changes.
///
/// A cluster that loses all its points takes the point that is farthest from its centre. With fewer distinct
/// points than clusters, centres repeat and the later of equal centres stay empty. Cost: points × clusters ×
/// dimension per round.
///
/// # Panics
/// If there are no points, a size is 0, or the length of `points` is not a multiple of `dimension`.
#[must_use]
pub fn kmeans(points: &[f32], dimension: usize, clusters: usize, seed: u64, iterations: usize) -> Clusters {
    assert!(dimension > 0 && clusters > 0, "dimension {dimension}, clusters {clusters}");
    assert!(!points.is_empty() && points.len().is_multiple_of(dimension), "{} numbers", points.len());
    let mut centres = first_centres(points, dimension, clusters, seed);
    let mut nearest = assign(points, dimension, &centres);
    for _ in 0..iterations {
        let before = nearest.iter().map(|(label, _)| *label).collect::<Vec<_>>();
        move_centres(points, dimension, &nearest, &mut centres);
        nearest = assign(points, dimension, &centres);
        if nearest.iter().map(|(label, _)| *label).eq(before) {
            break;
        }
    }
    let mut sizes = vec![0; clusters];
    nearest.iter().for_each(|(label, _)| sizes[*label as usize] += 1);
    Clusters {
        centres,
        labels: nearest.iter().map(|(label, _)| *label).collect(),
        sizes,
        inertia: nearest.iter().map(|(_, squared)| f64::from(*squared)).sum(),
    }
}

fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}

fn first_centres(points: &[f32], dimension: usize, clusters: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let row_count = points.len() / dimension;
    let row = |i: usize| &points[i * dimension..][..dimension];
    let mut centres = Vec::with_capacity(clusters * dimension);
    centres.extend_from_slice(row(rng.random_range(0..row_count)));
    let mut squared: Vec<f32> = vec![f32::INFINITY; row_count];
    for k in 1..clusters {
        let newest = &centres[(k - 1) * dimension..];
        for (s, point) in squared.iter_mut().zip(points.chunks_exact(dimension)) {
            *s = s.min(squared_distance(point, newest));
        }
        let total: f64 = squared.iter().map(|&s| f64::from(s)).sum();
        let mut left = rng.random::<f64>() * total;
        // Rounding may leave a remainder beyond the last point. The farthest point is drawn then.
        let drawn = squared.iter().position(|&s| {
            left -= f64::from(s);
            left < 0.0
        });
        let next = drawn.unwrap_or_else(|| farthest(squared.iter().copied()));
        centres.extend_from_slice(row(next));
    }
    centres
}

fn farthest(squared: impl Iterator<Item = f32>) -> usize {
    squared.enumerate().fold((0, f32::MIN), |best, (i, s)| if s > best.1 { (i, s) } else { best }).0
}

/// The nearest centre of each point (the first among equals) and its squared distance.
fn assign(points: &[f32], dimension: usize, centres: &[f32]) -> Vec<(u32, f32)> {
    points
        .chunks_exact(dimension)
        .map(|point| {
            let mut best = (0, f32::INFINITY);
            for (k, centre) in centres.chunks_exact(dimension).enumerate() {
                let squared = squared_distance(point, centre);
                if squared < best.1 {
                    best = (k as u32, squared);
                }
            }
            best
        })
        .collect()
}

/// Moves every centre to the mean of its points.
fn move_centres(points: &[f32], dimension: usize, nearest: &[(u32, f32)], centres: &mut [f32]) {
    let clusters = centres.len() / dimension;
    let mut sums = vec![0.0_f64; centres.len()];
    let mut sizes = vec![0_usize; clusters];
    for (point, (label, _)) in points.chunks_exact(dimension).zip(nearest) {
        let k = *label as usize;
        sizes[k] += 1;
        sums[k * dimension..][..dimension].iter_mut().zip(point).for_each(|(sum, &x)| *sum += f64::from(x));
    }
    let mut squared: Vec<f32> = nearest.iter().map(|(_, s)| *s).collect();
    for (k, centre) in centres.chunks_exact_mut(dimension).enumerate() {
        if sizes[k] == 0 {
            let taken = farthest(squared.iter().copied());
            squared[taken] = 0.0;
            centre.copy_from_slice(&points[taken * dimension..][..dimension]);
        } else {
            let mean = sums[k * dimension..].iter().map(|sum| (sum / sizes[k] as f64) as f32);
            centre.iter_mut().zip(mean).for_each(|(c, m)| *c = m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn well_separated_groups_are_found() {
        let mut points = Vec::new();
        for i in 0..30 {
            let offset = (i % 5) as f32 * 0.01;
            let (x, y) = [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)][i % 3];
            points.extend([x + offset, y - offset]);
        }
        for seed in 0..20 {
            let found = kmeans(&points, 2, 3, seed, 20);
            assert_eq!(found.sizes, [10, 10, 10], "seed {seed}");
            assert!((found.inertia - 30.0 * 2.0 * 0.0002).abs() < 1e-4, "seed {seed}: {}", found.inertia);
        }
    }

    #[test]
    fn one_cluster_has_the_mean_as_centre() {
        let found = kmeans(&[1.0, 2.0, 3.0, 10.0], 1, 1, 0, 5);
        assert_eq!(found.centres, [4.0]);
        assert_eq!(found.inertia, 9.0 + 4.0 + 1.0 + 36.0);
    }

    #[test]
    fn repeated_points_leave_clusters_empty() {
        let found = kmeans(&[5.0, 5.0, 5.0, 7.0], 1, 3, 1, 10);
        assert_eq!(found.inertia, 0.0);
        assert_eq!(found.sizes.iter().sum::<usize>(), 4);
        assert!(found.centres.iter().all(|c| *c == 5.0 || *c == 7.0));
    }

    #[test]
    fn an_emptied_cluster_takes_the_farthest_point() {
        let points = [0.0, 1.0, 2.0, 50.0];
        let mut centres = [1.0, 900.0];
        let nearest = assign(&points, 1, &centres);
        move_centres(&points, 1, &nearest, &mut centres);
        assert_eq!(centres, [13.25, 50.0]);
    }

    proptest! {
        #[test]
        fn clusters_repeat_by_seed_and_points_are_at_their_nearest(
            points in prop::collection::vec(-10.0f32..10.0, 3..60),
            clusters in 1_usize..6,
            seed in any::<u64>(),
        ) {
            let points = &points[..points.len() / 3 * 3];
            let found = kmeans(points, 3, clusters, seed, 8);
            prop_assert_eq!(&found, &kmeans(points, 3, clusters, seed, 8));
            prop_assert_eq!(found.sizes.iter().sum::<usize>(), points.len() / 3);
            for (point, &label) in points.chunks_exact(3).zip(&found.labels) {
                let own = squared_distance(point, &found.centres[label as usize * 3..][..3]);
                let all = found.centres.chunks_exact(3).all(|c| own <= squared_distance(point, c));
                prop_assert!(all);
            }
        }

        #[test]
        fn more_rounds_never_raise_the_inertia(points in prop::collection::vec(-10.0f32..10.0, 20..80)) {
            let points = &points[..points.len() / 2 * 2];
            let few = kmeans(points, 2, 4, 3, 1).inertia;
            let many = kmeans(points, 2, 4, 3, 10).inertia;
            prop_assert!(many <= few * (1.0 + 1e-5) + 1e-5);
        }
    }
}
