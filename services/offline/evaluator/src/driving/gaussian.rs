//! Gaussians in two dimensions.

use std::f64::consts::PI;

/// Minimum variance: a position is known to 1 cm at best.
const VARIANCE_MIN_M2: f64 = 1e-4;

/// A Gaussian distribution of positions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gaussian {
    mean_m: [f64; 2],
    /// (xx, xy, yy).
    covariance_m2: [f64; 3],
}

impl Gaussian {
    /// A Gaussian with this covariance (xx, xy, yy) plus the minimum variance.
    pub(crate) fn new(mean_m: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Self {
        Self { mean_m, covariance_m2: [xx + VARIANCE_MIN_M2, xy, yy + VARIANCE_MIN_M2] }
    }

    /// Fits a Gaussian to positions in m.
    pub(crate) fn fit(points_m: &[[f32; 2]]) -> Self {
        let points = || points_m.iter().map(|point| point.map(f64::from));
        let len = points_m.len().max(1) as f64;
        let mean_m = [0, 1].map(|axis| points().map(|point| point[axis]).sum::<f64>() / len);
        let covariance_m2 = [(0, 0), (0, 1), (1, 1)].map(|(a, b)| {
            points().map(|point| (point[a] - mean_m[a]) * (point[b] - mean_m[b])).sum::<f64>() / len
        });
        Self::new(mean_m, covariance_m2)
    }

    pub(crate) fn determinant(&self) -> f64 {
        let [xx, xy, yy] = self.covariance_m2;
        (xx * yy - xy * xy).max(VARIANCE_MIN_M2 * VARIANCE_MIN_M2)
    }

    /// Squared Mahalanobis distance of a position.
    pub(crate) fn square(&self, point_m: [f32; 2]) -> f64 {
        let [x, y] = [0, 1].map(|axis| f64::from(point_m[axis]) - self.mean_m[axis]);
        let [xx, xy, yy] = self.covariance_m2;
        (yy * x * x - 2.0 * xy * x * y + xx * y * y) / self.determinant()
    }

    /// Area of the ellipse at one standard deviation, m².
    pub(crate) fn area_m2(&self) -> f64 {
        PI * self.determinant().sqrt()
    }
}
