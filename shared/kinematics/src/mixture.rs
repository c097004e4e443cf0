/// Mean and covariance of a position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// Mean (x, y), m.
    pub mean: [f32; 2],
    /// Covariance (xx, xy, yy), m².
    pub covariance: [f32; 3],
}

/// The moments of a mixture of Gaussians whose weights sum to 1. The covariance contains the components'
/// covariances and the spread of their means.
#[must_use]
pub fn mixture(components: impl Iterator<Item = (f32, Moments)> + Clone) -> Moments {
    let mut mixed = Moments::default();
    for (weight, component) in components.clone() {
        mixed.mean = [0, 1].map(|axis| mixed.mean[axis] + weight * component.mean[axis]);
    }
    for (weight, component) in components {
        let [dx, dy] = [0, 1].map(|axis| component.mean[axis] - mixed.mean[axis]);
        for (sum, (own, between)) in
            mixed.covariance.iter_mut().zip(component.covariance.iter().zip([dx * dx, dx * dy, dy * dy]))
        {
            *sum += weight * (own + between);
        }
    }
    mixed
}

/// The moments of equally likely points; zeros if there are no points.
#[must_use]
pub fn spread(points_m: impl ExactSizeIterator<Item = [f32; 2]> + Clone) -> Moments {
    let weight = 1.0 / points_m.len().max(1) as f32;
    mixture(points_m.map(|mean| (weight, Moments { mean, covariance: [0.0; 3] })))
}
