//! Runs of Kalman filters over recorded measurements.
//!
//! `parameters.json` contains the noise. `meas*.csv` contains the measurements at every tick of every track.
//! `cv_kf*.csv` and the other files contain mean, covariance and normalised innovation squared (NIS) of each
//! filter after each tick. A track starts with its first detection.

use filters::{Bicycle, ConstantAcceleration, ConstantVelocity, Filter, Integrator};
use serde::Deserialize;

use super::figures::Figures;
use super::ledger::Ledger;
use super::part::{Part, document};
use super::recording::{Recording, Run};
use crate::VerifyError;

/// The step to which the noise of [`Bicycle`] refers, and the longest step of a process.
const STEP_S: f64 = 0.08;

/// `parameters.json`. It contains a filter's parameters if the folder has the filter.
#[derive(Deserialize)]
struct Parameters {
    dt_s: f64,
    sigma_m: f64,
    rear_axle_m: Option<f64>,
    initial_velocity_variance: Option<f64>,
    initial_acceleration_variance: Option<f64>,
    cv: Option<AxisNoise>,
    ca: Option<AxisNoise>,
    ekf_bic_heading: Option<BicycleNoise>,
    ekf_bic_posonly: Option<BicycleNoise>,
    #[serde(default)]
    figures_odd_tracks_after_burn_in: Figures,
    #[serde(default)]
    burn_in_ticks: u64,
}

/// White noise per axis.
#[derive(Clone, Copy, Deserialize)]
struct AxisNoise {
    /// Spectral density.
    q: f64,
}

/// Noise of a bicycle in one step, and its initial variances.
#[derive(Clone, Copy, Deserialize)]
struct BicycleNoise {
    sig_a: f64,
    sig_bd: f64,
    q_floor: [f64; 5],
    /// Of the initial heading, and of every measured one.
    sig_psi: f64,
    #[serde(rename = "Pv0")]
    speed_variance: f64,
    #[serde(rename = "Pb0")]
    slip_variance: f64,
}

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let path = part.expect("parameters.json")?;
    let parameters: Parameters = document(&path)?;
    let wrong = |reason: String| VerifyError::malformed(&path, reason);
    if !(parameters.dt_s > 0.0 && parameters.dt_s <= STEP_S) {
        return Err(wrong(format!("dt_s {} is not above 0 and at most {STEP_S}", parameters.dt_s)));
    }
    let need = |value: Option<f64>, key: &str| value.ok_or_else(|| wrong(format!("{key} is missing")));
    let position = parameters.sigma_m.powi(2);
    let recording = Recording::read(part, parameters.dt_s, position, parameters.burn_in_ticks)?;
    let figures = &parameters.figures_odd_tracks_after_burn_in;
    if let Some(AxisNoise { q }) = parameters.cv {
        let speed = need(parameters.initial_velocity_variance, "initial_velocity_variance")?;
        let run = Run {
            file: "cv_kf",
            figures: figures.of("cv"),
            process: ConstantVelocity { density: q },
            start: |tick| [tick.position_m[0], tick.position_m[1], 0.0, 0.0],
            start_variance: [position, position, speed, speed],
            heading_variance: None,
            filter: Filter::ConstantVelocity,
        };
        recording.compare(&run, part, ledger)?;
    }
    if let Some(AxisNoise { q }) = parameters.ca {
        let speed = need(parameters.initial_velocity_variance, "initial_velocity_variance")?;
        let acceleration = need(parameters.initial_acceleration_variance, "initial_acceleration_variance")?;
        let run = Run {
            file: "ca_kf",
            figures: figures.of("ca"),
            process: ConstantAcceleration { density: q },
            start: |tick| [tick.position_m[0], tick.position_m[1], 0.0, 0.0, 0.0, 0.0],
            start_variance: [position, position, speed, speed, acceleration, acceleration],
            heading_variance: None,
            filter: |state| Filter::ConstantVelocity(ConstantAcceleration::cartesian(&state)),
        };
        recording.compare(&run, part, ledger)?;
    }
    let bicycles = [
        ("ekf_bic_heading", parameters.ekf_bic_heading, true),
        ("ekf_bic_posonly", parameters.ekf_bic_posonly, false),
    ];
    for (name, noise, measures_heading) in bicycles {
        if let Some(noise) = noise {
            let rear_axle_m = need(parameters.rear_axle_m, "rear_axle_m")?;
            let heading = noise.sig_psi.powi(2);
            let run = Run {
                file: name,
                figures: figures.of(name),
                process: bicycle(&noise, rear_axle_m, parameters.dt_s),
                start: |tick| [tick.position_m[0], tick.position_m[1], tick.heading_rad, 0.0, 0.0],
                start_variance: [position, position, heading, noise.speed_variance, noise.slip_variance],
                heading_variance: measures_heading.then_some(heading),
                filter: Filter::Bicycle,
            };
            recording.compare(&run, part, ledger)?;
        }
    }
    Ok(())
}

/// The bicycle with the given noise in a step of `dt_s`. The slip has no limit.
fn bicycle(noise: &BicycleNoise, rear_axle_m: f64, dt_s: f64) -> Bicycle {
    let steps = dt_s / STEP_S;
    Bicycle {
        rear_axle_m,
        integrator: Integrator::Euler,
        acceleration_mps2: noise.sig_a * steps.sqrt(),
        slip_rate_radps: noise.sig_bd * steps.sqrt(),
        slip_decay_per_s: 0.0,
        floor: noise.q_floor.map(|variance| variance / steps),
        slip_max_rad: f64::INFINITY,
    }
}
