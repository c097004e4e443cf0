//! Recordings as a noisy sensor reports them.
//!
//! A recording holds positions that are nearly exact. A detector on a vehicle reports other ones: with noise,
//! with noise that lasts from frame to frame, with missed detections, and without identities. [`Noise`] makes
//! such detections of a recording. The truth remains in the clean recording.
//!
//! The noise of an agent is a first-order autoregressive process per axis, with a stationary standard deviation
//! σ and a time constant τ:
//!
//! ```text
//! n(t₀) = σ w₀        n(t + Δt) = φ n(t) + σ √(1 − φ²) w        φ = exp(−Δt / τ), 0 for white noise
//! ```
//!
//! The numbers w come from ChaCha8. The key consists of the seed, the recording's name, the agent's identity
//! and the time of the measurement. So a detection's noise depends neither on threads nor on the order of the
//! detections.

use std::collections::BTreeMap;

use data::{Lines, Recording};
use filters::wrapped;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use wire::{Detection, detection_flags};

/// Time over which a detector differences positions to a speed, s. The standard deviation of a reported speed
/// is the standard deviation of a position over this time.
const SPEED_S: f64 = 1.0;
/// Marks the keys of detections without identity.
const WITHOUT_ID: u64 = 1 << 63;

/// The errors of a sensor. The default is a sensor without errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation of a position per axis, m. A reported speed has the same standard deviation in m/s.
    pub sigma_m: f64,
    /// Standard deviation of a reported heading, rad.
    pub heading_rad: f64,
    /// Share of detections that are missing, at random.
    pub drop_share: f64,
    /// Whether detections have no identities.
    pub without_ids: bool,
    /// Time constant of the noise, s; 0 for white noise.
    pub lag_s: f64,
    /// Whether detections report `sigma_m`.
    pub reports_sigma: bool,
    /// Whether detections have neither headings nor speeds.
    pub positions_only: bool,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// The noise of an agent at its last measurement, in units of the standard deviation: x, y, heading, speed.
type Units = [f64; 4];

/// An agent's last measurement.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp_ns: i64,
    units: Units,
}

impl Noise {
    /// Whether the sensor changes nothing.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self { seed: self.seed, lag_s: self.lag_s, ..Self::default() }
    }

    /// The options of the command line that choose this sensor, each after a space.
    #[must_use]
    pub fn arguments(&self) -> String {
        let numbers = [
            ("--noise", self.sigma_m),
            ("--lag", self.lag_s),
            ("--noise-heading", self.heading_rad.to_degrees()),
            ("--drop", self.drop_share),
        ];
        let flags = [
            ("--no-ids", self.without_ids),
            ("--sigma", self.reports_sigma),
            ("--positions", self.positions_only),
        ];
        let numbers = numbers.iter().filter(|(_, value)| *value > 0.0);
        let numbers = numbers.map(|(name, value)| {
            format!(" {name} {value:.6}").trim_end_matches('0').trim_end_matches('.').to_owned()
        });
        let flags = flags.iter().filter(|(_, is_set)| *is_set).map(|(name, _)| format!(" {name}"));
        numbers.chain(flags).collect()
    }

    /// The options that choose this sensor, for a title; empty if the sensor changes nothing.
    pub(crate) fn label(&self) -> String {
        if self.is_none() { String::new() } else { format!(", detections with{}", self.arguments()) }
    }

    /// The recording as the sensor reports it.
    ///
    /// Name, fingerprint, frames and true positions remain. A detection keeps its time, type, size and score.
    /// Its lines in the file are unknown.
    #[must_use]
    pub fn applied_to(&self, recording: &Recording) -> Recording {
        if self.is_none() {
            return recording.clone();
        }
        let name = hash(&recording.name);
        let mut lasts: BTreeMap<u64, Last> = BTreeMap::new();
        let mut noisy = recording.clone();
        noisy.has_identities &= !self.without_ids;
        for frame in &mut noisy.frames {
            frame.lines = Lines::default();
            let mut place = 0;
            let frame_ns = frame.stamp_ns;
            frame.detections.retain_mut(|detection| {
                place += 1;
                let has_id = detection.has(detection_flags::HAS_ID);
                let id = if has_id { detection.id } else { WITHOUT_ID | place };
                let stamp_ns = frame_ns + detection.offset_ns;
                let mut rng = self.rng(name, id, stamp_ns);
                let is_kept = rng.random::<f64>() >= self.drop_share;
                let drawn = std::array::from_fn(|_| normal(&mut rng));
                let last = lasts.get(&id).copied().filter(|_| has_id);
                let units = self.next(last, stamp_ns, drawn);
                if has_id {
                    lasts.insert(id, Last { stamp_ns, units });
                }
                self.perturb(detection, units);
                is_kept
            });
        }
        noisy
    }

    fn rng(&self, name: u64, id: u64, stamp_ns: i64) -> ChaCha8Rng {
        let mut key = [0; 32];
        let parts = [self.seed, name, id, stamp_ns.cast_unsigned()];
        for (bytes, part) in key.chunks_exact_mut(8).zip(parts) {
            bytes.copy_from_slice(&part.to_le_bytes());
        }
        ChaCha8Rng::from_seed(key)
    }

    /// The next value of an agent's process.
    fn next(&self, last: Option<Last>, stamp_ns: i64, drawn: Units) -> Units {
        let Some(last) = last.filter(|_| self.lag_s > 0.0) else { return drawn };
        let elapsed_s = stamp_ns.abs_diff(last.stamp_ns) as f64 * 1e-9;
        let phi = (-elapsed_s / self.lag_s).exp();
        let fresh = (1.0 - phi * phi).sqrt();
        std::array::from_fn(|axis| phi * last.units[axis] + fresh * drawn[axis])
    }

    fn perturb(&self, detection: &mut Detection, [x, y, heading, speed]: Units) {
        detection.x_m = (f64::from(detection.x_m) + self.sigma_m * x) as f32;
        detection.y_m = (f64::from(detection.y_m) + self.sigma_m * y) as f32;
        if self.positions_only {
            detection.flags &= !(detection_flags::HAS_HEADING | detection_flags::HAS_SPEED);
            (detection.heading_rad, detection.speed_mps) = (0.0, 0.0);
        }
        if detection.has(detection_flags::HAS_HEADING) && self.heading_rad > 0.0 {
            let heading_rad = f64::from(detection.heading_rad) + self.heading_rad * heading;
            detection.heading_rad = wrapped(heading_rad) as f32;
        }
        if detection.has(detection_flags::HAS_SPEED) {
            let noise_mps = self.sigma_m / SPEED_S * speed;
            detection.speed_mps = (f64::from(detection.speed_mps) + noise_mps) as f32;
        }
        if self.reports_sigma && self.sigma_m > 0.0 {
            detection.sigma_m = self.sigma_m as f32;
        }
        if self.without_ids {
            detection.flags &= !detection_flags::HAS_ID;
            detection.id = 0;
        }
    }
}

/// A standard normal number by the transform of Box and Muller.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// FNV-1a of a name.
fn hash(name: &str) -> u64 {
    let add = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    name.bytes().fold(0xcbf2_9ce4_8422_2325, add)
}

#[cfg(test)]
mod tests;
