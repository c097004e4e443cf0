use crate::score::rounded;

/// Range of motion of nearly all training windows of a type.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Fitness {
    /// Largest speed.
    pub speed_max_mps: f64,
    /// Strongest braking (negative) and acceleration along the course.
    pub accel_mps2: [f64; 2],
    /// Largest acceleration across the course.
    pub lateral_accel_max_mps2: f64,
}

impl Fitness {
    /// The range of motion within the bounds of the base control's features.
    #[must_use]
    pub(crate) fn within(bounds: &[[f32; 2]]) -> Self {
        use nn::base::{ACCELERATION, LATERAL_ACCELERATION, SPEED_SQUARED};
        let value = |x: f32| rounded(f64::from(x));
        Self {
            speed_max_mps: value(bounds[SPEED_SQUARED][1].max(0.0).sqrt()),
            accel_mps2: bounds[ACCELERATION].map(value),
            lateral_accel_max_mps2: value(bounds[LATERAL_ACCELERATION][1]),
        }
    }
}
