use nalgebra::{SMatrix, SVector};

use crate::gaussian::symmetrised;
use crate::{Gaussian, wrapped};

/// The mean of weighted points. It is circular for the components `angles`. The weights sum to 1.
#[must_use]
pub fn mean<'a, const N: usize>(
    points: impl Iterator<Item = (f64, &'a SVector<f64, N>)>,
    angles: &[usize],
) -> SVector<f64, N> {
    let [mut mean, mut sin, mut cos] = [SVector::<f64, N>::zeros(); 3];
    for (weight, point) in points {
        mean += point * weight;
        for &angle in angles {
            sin[angle] += weight * point[angle].sin();
            cos[angle] += weight * point[angle].cos();
        }
    }
    for &angle in angles {
        mean[angle] = wrapped(f64::atan2(sin[angle], cos[angle]));
    }
    mean
}

/// `point` minus `from`. The components `angles` take the shorter way around the circle.
#[must_use]
pub fn difference<const N: usize>(
    point: &SVector<f64, N>,
    from: &SVector<f64, N>,
    angles: &[usize],
) -> SVector<f64, N> {
    let mut difference = point - from;
    for &angle in angles {
        difference[angle] = wrapped(difference[angle]);
    }
    difference
}

/// Moment matching: the Gaussian with the moments of a mixture. Its covariance contains the components'
/// covariances and the spread of their means. The weights sum to 1.
#[must_use]
pub fn moments<'a, const N: usize>(
    components: impl Iterator<Item = (f64, &'a Gaussian<N>)> + Clone,
    angles: &[usize],
) -> Gaussian<N> {
    let mean = mean(components.clone().map(|(weight, component)| (weight, &component.mean)), angles);
    let mut covariance = SMatrix::zeros();
    for (weight, component) in components {
        let off = difference(&component.mean, &mean, angles);
        covariance += (component.covariance + off * off.transpose()) * weight;
    }
    Gaussian { mean, covariance: symmetrised(&covariance) }
}

/// As [`moments`], without circular means: the components `angles` are taken relative to the first component's,
/// and the others are assumed to be near it. There is at least one component.
#[must_use]
pub fn moments_near<const N: usize>(components: &[(f64, &Gaussian<N>)], angles: &[usize]) -> Gaussian<N> {
    let [(_, first), others @ ..] = components else { return Gaussian::new([0.0; N], [0.0; N]) };
    let off = |component: &Gaussian<N>| difference(&component.mean, &first.mean, angles);
    let shift =
        others.iter().fold(SVector::zeros(), |sum, &(weight, component)| sum + off(component) * weight);
    let mut covariance = SMatrix::zeros();
    for &(weight, component) in components {
        let off = off(component) - shift;
        covariance += (component.covariance + off * off.transpose()) * weight;
    }
    let mut mean = first.mean + shift;
    for &angle in angles {
        mean[angle] = wrapped(mean[angle]);
    }
    Gaussian { mean, covariance }
}

/// Sample mean of equally likely points, and their sample covariance with divisor n − 1.
#[must_use]
pub fn sample_moments<const N: usize>(points: &[SVector<f64, N>], angles: &[usize]) -> Gaussian<N> {
    let weight = 1.0 / points.len().max(1) as f64;
    let weighted = || points.iter().map(|point| (weight, point));
    let mean = mean(weighted(), angles);
    let unbiased = points.len() as f64 / points.len().saturating_sub(1).max(1) as f64;
    Gaussian { mean, covariance: scatter(weighted(), &mean, angles) * unbiased }
}

/// Covariance of weighted points about their mean. The weights sum to 1.
pub(crate) fn scatter<'a, const N: usize>(
    points: impl Iterator<Item = (f64, &'a SVector<f64, N>)>,
    mean: &SVector<f64, N>,
    angles: &[usize],
) -> SMatrix<f64, N, N> {
    let mut covariance = SMatrix::zeros();
    for (weight, point) in points {
        let off = difference(point, mean, angles);
        covariance += off * off.transpose() * weight;
    }
    symmetrised(&covariance)
}

/// The point at `share` of the way from `before` to `after`. The components `angles` take the shorter way
/// around the circle.
#[must_use]
pub fn interpolated<const N: usize>(
    before: &SVector<f64, N>,
    after: &SVector<f64, N>,
    share: f64,
    angles: &[usize],
) -> SVector<f64, N> {
    let mut point = before + difference(after, before, angles) * share;
    for &angle in angles {
        point[angle] = wrapped(point[angle]);
    }
    point
}
