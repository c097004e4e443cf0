use crate::spread;

/// A density over the plane from sample positions: a Gaussian product kernel on each of them. \[paper, Monte Carlo\]
#[derive(Clone, Copy, Debug)]
pub struct KernelDensity<'a> {
    points_m: &'a [[f32; 2]],
    bandwidth_m: [f32; 2],
}

impl<'a> KernelDensity<'a> {
    /// Bandwidths by Silverman's rule, h = σ n^(−1/6) per axis, no smaller than `floor_m`. `None` without points.
    ///
    /// # Panics
    /// Where `floor_m` is not positive.
    #[must_use]
    pub fn new(points_m: &'a [[f32; 2]], floor_m: f32) -> Option<Self> {
        assert!(floor_m > 0.0, "a kernel needs a width");
        if points_m.is_empty() {
            return None;
        }
        let [xx, _, yy] = spread(points_m.iter().copied()).covariance;
        let shrink = (points_m.len() as f32).powf(-1.0 / 6.0);
        Some(Self { points_m, bandwidth_m: [xx, yy].map(|v| (v.sqrt() * shrink).max(floor_m)) })
    }

    /// The kernel's standard deviation per axis.
    #[must_use]
    pub const fn bandwidth_m(&self) -> [f32; 2] {
        self.bandwidth_m
    }

    /// The density at a point, 1/m².
    #[must_use]
    pub fn at(&self, point_m: [f32; 2]) -> f32 {
        let [hx, hy] = self.bandwidth_m;
        let sum: f32 = self
            .points_m
            .iter()
            .map(|centre| {
                let (dx, dy) = ((point_m[0] - centre[0]) / hx, (point_m[1] - centre[1]) / hy);
                (-0.5 * (dx * dx + dy * dy)).exp()
            })
            .sum();
        sum / (std::f32::consts::TAU * hx * hy * self.points_m.len() as f32)
    }
}
