use super::frame::{TrackingError, check, distance_m};

/// Sums over the Euclidean norms of errors. They can be merged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorNorms {
    /// Number of norms.
    pub len: u64,
    /// Sum of the norms.
    pub sum: f64,
    /// Sum of the squared norms.
    pub squared_sum: f64,
}

impl ErrorNorms {
    /// Counts the norm (≥ 0) of one error.
    pub fn add(&mut self, norm: f64) {
        self.merge(&Self { len: 1, sum: norm, squared_sum: norm * norm });
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.len += other.len;
        self.sum += other.sum;
        self.squared_sum += other.squared_sum;
    }

    /// Root of the mean squared norm; `None` if nothing was counted.
    pub fn rmse(&self) -> Option<f64> {
        (self.len > 0).then(|| (self.squared_sum / self.len as f64).sqrt())
    }

    /// Mean norm; `None` if nothing was counted.
    pub fn mae(&self) -> Option<f64> {
        (self.len > 0).then(|| self.sum / self.len as f64)
    }
}

/// Position and velocity of an object at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlanarState {
    /// Position (x, y).
    pub position_m: [f64; 2],
    /// Velocity (x, y).
    pub velocity_mps: [f64; 2],
}

/// Errors of position and velocity, as norms over both axes: √2 times the errors of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionErrors {
    /// Distances between estimated and true position, in metres.
    pub position_m: ErrorNorms,
    /// Norms of the velocity error, in metres per second.
    pub velocity_mps: ErrorNorms,
}

impl MotionErrors {
    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.position_m.merge(&other.position_m);
        self.velocity_mps.merge(&other.velocity_mps);
    }
}

/// Errors of a tracker's states, separate for instants with and without a detection of the object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StateErrors {
    /// Instants with a detection.
    pub visible: MotionErrors,
    /// Instants without a detection, in which the track coasts.
    pub occluded: MotionErrors,
}

impl StateErrors {
    /// Counts the error of one object at one instant.
    ///
    /// # Errors
    /// If the error is not finite because the estimate or truth is invalid. Nothing is counted then.
    pub fn add(
        &mut self,
        visible: bool,
        truth: &PlanarState,
        estimate: &PlanarState,
    ) -> Result<(), TrackingError> {
        let position_m = distance_m(truth.position_m, estimate.position_m);
        let velocity_mps = distance_m(truth.velocity_mps, estimate.velocity_mps);
        check("position error", position_m, position_m.is_finite(), "finite")?;
        check("velocity error", velocity_mps, velocity_mps.is_finite(), "finite")?;
        let errors = if visible { &mut self.visible } else { &mut self.occluded };
        errors.position_m.add(position_m);
        errors.velocity_mps.add(velocity_mps);
        Ok(())
    }

    /// Visible and occluded together.
    pub fn all(&self) -> MotionErrors {
        let mut all = self.visible;
        all.merge(&self.occluded);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: PlanarState = PlanarState { position_m: [1.0, 1.0], velocity_mps: [2.0, 0.0] };

    fn off_by(x_m: f64, y_mps: f64) -> PlanarState {
        PlanarState { position_m: [1.0 + x_m, 1.0], velocity_mps: [2.0, y_mps] }
    }

    #[test]
    fn visible_and_occluded_errors_are_separate() {
        let mut errors = StateErrors::default();
        errors.add(true, &TRUTH, &off_by(3.0, 0.5)).unwrap();
        errors.add(true, &TRUTH, &off_by(-4.0, 0.5)).unwrap();
        errors.add(false, &TRUTH, &off_by(8.0, -1.0)).unwrap();
        assert_eq!(errors.visible.position_m.rmse(), Some(12.5_f64.sqrt()));
        assert_eq!(errors.visible.position_m.mae(), Some(3.5));
        assert_eq!(errors.occluded.velocity_mps.mae(), Some(1.0));
        assert_eq!(errors.all().position_m.mae(), Some(5.0));
        assert_eq!(StateErrors::default().visible.position_m.rmse(), None);
    }

    #[test]
    fn invalid_estimates_are_refused_whole() {
        let mut errors = StateErrors::default();
        let refused = errors.add(true, &TRUTH, &off_by(0.0, f64::NAN)).unwrap_err();
        assert_eq!(refused.to_string(), "velocity error = NaN is not finite");
        assert_eq!(errors, StateErrors::default());
    }
}
