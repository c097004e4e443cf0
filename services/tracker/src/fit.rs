use std::f64::consts::TAU;

/// How well the position of a detection fits a predicted track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Mahalanobis distance, squared.
    pub distance2: f64,
    /// Determinant of the innovation's covariance.
    pub det: f64,
}

impl Fit {
    /// The fit of a position with this offset from the prediction. The prediction has the covariance (xx, xy,
    /// yy).
    #[must_use]
    pub fn new([dx, dy]: [f64; 2], [xx, xy, yy]: [f64; 3], variance: f64) -> Self {
        let (xx, yy) = (xx + variance, yy + variance);
        let det = xx * yy - xy * xy;
        let distance2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det;
        Self { distance2, det }
    }

    /// Logarithm of the detection's density under the prediction, per m².
    #[must_use]
    pub fn log_density(&self) -> f64 {
        -0.5 * self.cost() - TAU.ln()
    }

    /// d² + ln |S|: −2 ln of the density, up to a constant.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.distance2 + self.det.ln()
    }
}
