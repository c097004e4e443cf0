use kinematics::{MotionKind, MotionOptions};

/// How the spread of the controls is carried on to positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Propagation {
    /// One Gaussian per mode, through the derivatives of the motion model.
    #[default]
    Linearised,
    /// Particles per mode, through the motion model itself.
    MonteCarlo {
        /// Particles of each mode, at most [`kinematics::PARTICLES_MAX`].
        particles: usize,
    },
}

/// Settings of a [`Sampler`](crate::Sampler).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplerOptions {
    /// Steps of the history window, T_h.
    pub history_len: usize,
    /// Steps of the forecast, T_f.
    pub horizon_len: usize,
    /// What the controls of vehicles are; those of all others are displacements.
    pub vehicle_motion: MotionKind,
    /// The constants of motion.
    pub motion: MotionOptions,
    /// Whether the track's own covariance is where a forecast's covariance begins; 0 otherwise.
    pub initial_covariance: bool,
    /// How the spread of the controls is carried on.
    pub propagation: Propagation,
    /// Seed of the particles' random numbers.
    pub seed: u64,
    /// Whether forecasts learn from the memory of the place how those who came by earlier went on.
    pub recalls: bool,
    /// Oldest learned forecast that is still told as held.
    pub max_age_ns: u64,
}

impl Default for SamplerOptions {
    fn default() -> Self {
        Self {
            history_len: 8,
            horizon_len: 12,
            vehicle_motion: MotionKind::Bicycle,
            motion: MotionOptions::default(),
            initial_covariance: true,
            propagation: Propagation::Linearised,
            seed: 0,
            recalls: true,
            max_age_ns: 1_600_000_000,
        }
    }
}
