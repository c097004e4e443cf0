use kinematics::{ControlLimits, DisplacementKind, Integrator};

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
    /// Whether vehicles are moved by the controls of a bicycle; by displacements as all others otherwise.
    pub vehicles_drive: bool,
    /// Integrator of the bicycle.
    pub integrator: Integrator,
    /// Where a vehicle's controls saturate.
    pub limits: ControlLimits,
    /// Largest slip angle, if there is a limit.
    pub slip_limit_rad: Option<f32>,
    /// Whether a vehicle's first slip is read off its headings; 0 otherwise.
    pub initial_slip: bool,
    /// Distance of the rear axle from the centre over the length.
    pub rear_axle_ratio: f32,
    /// Length of vehicles whose length is unknown.
    pub default_length_m: f32,
    /// What a displacement stands for.
    pub displacement: DisplacementKind,
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
            vehicles_drive: true,
            integrator: Integrator::Midpoint,
            limits: ControlLimits { accel_mps2: 6.0, slip_rate_radps: 1.0 },
            slip_limit_rad: Some(0.5),
            initial_slip: true,
            rear_axle_ratio: 0.26,
            default_length_m: 4.5,
            displacement: DisplacementKind::Residual,
            initial_covariance: true,
            propagation: Propagation::Linearised,
            seed: 0,
            recalls: true,
            max_age_ns: 1_600_000_000,
        }
    }
}
