//! Single functions: a bicycle's Jacobian, association probabilities, particles, moments of samples.

use std::path::Path;

use association::jpda::{JointAssociation, JpdaFault, Sensor};
use filters::{Integrator, interpolated, sample_moments};
use kinematics::Bicycle;
use nalgebra::{Vector2, Vector5};
use serde::Deserialize;

use super::ledger::{EXACT, Ledger, Rule};
use super::part::{Part, document};
use super::particles;
use crate::VerifyError;

/// Index of the heading in a bicycle's state [x, y, ψ, v, β].
const HEADING: usize = 2;

/// For rows that are bicycle states.
const STATE: Rule<'static> = Rule { angles: &[HEADING], ..EXACT };

/// `jacobian.json`: steps of a bicycle without control.
#[derive(Deserialize)]
struct Jacobians {
    #[serde(rename = "DT")]
    dt_s: f64,
    #[serde(rename = "LR")]
    rear_axle_m: f64,
    cases: Vec<Jacobian>,
}

#[derive(Deserialize)]
struct Jacobian {
    /// The state before the step.
    s: [f64; 5],
    #[serde(rename = "J")]
    by_state: [[f64; 5]; 5],
    /// The state after the step.
    f: [f64; 5],
    /// f − J s.
    affine: [f64; 5],
}

/// `jpda.json`.
#[derive(Deserialize)]
struct Associations {
    cases: Vec<AssociationCase>,
}

#[derive(Deserialize)]
struct AssociationCase {
    #[serde(rename = "PD")]
    detection_probability: f64,
    clutter: f64,
    /// Variance of the innovation per axis.
    #[serde(rename = "S_scalar")]
    innovation_variance: f64,
    /// Largest squared distance d² of a pair.
    gate: f64,
    tracks: Vec<[f64; 2]>,
    meas: Vec<[f64; 2]>,
    /// Normalised squared distances, per track.
    d2: Vec<Vec<f64>>,
    /// Probabilities of the detections and of the miss, per track.
    beta: Vec<Vec<f64>>,
}

/// `sample_prior.json`: bicycle states at equal steps, and moments of these samples, interpolated between
/// steps.
#[derive(Deserialize)]
struct Samples {
    step: f64,
    /// Per sample and step. The first step is at time 0.
    samples: Vec<Vec<[f64; 5]>>,
    queries: Vec<Moments>,
}

#[derive(Deserialize)]
struct Moments {
    /// The time.
    tau: f64,
    mean: [f64; 5],
    cov: [[f64; 5]; 5],
}

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    compare_jacobians(part, ledger)?;
    compare_associations(part, ledger)?;
    particles::compare(part, ledger)?;
    compare_samples(part, ledger)
}

fn compare_jacobians(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let file = "jacobian.json";
    let Some(path) = part.find(file) else { return Ok(()) };
    let Jacobians { dt_s, rear_axle_m, cases } = document(&path)?;
    let bicycle = Bicycle { rear_axle_m, slip_limit_rad: None, integrator: Integrator::Euler };
    let [mut jacobians, mut states, mut rests] = [const { Vec::new() }; 3];
    for case in &cases {
        let before = Vector5::from(case.s);
        let moved = bicycle.linearise(&before, &Vector2::zeros(), dt_s);
        jacobians.extend(moved.by_state.transpose().iter());
        states.extend(moved.next.iter());
        rests.extend((moved.next - moved.by_state * before).iter());
    }
    let case_count = cases.len();
    let expected: Vec<_> = cases.iter().flat_map(|case| case.by_state.as_flattened()).copied().collect();
    ledger.compare(part.vector(file, "J"), &[case_count, 5, 5], &jacobians, &expected, &EXACT);
    let expected: Vec<_> = cases.iter().flat_map(|case| case.f).collect();
    ledger.compare(part.vector(file, "f"), &[case_count, 5], &states, &expected, &STATE);
    let expected: Vec<_> = cases.iter().flat_map(|case| case.affine).collect();
    ledger.compare(part.vector(file, "affine"), &[case_count, 5], &rests, &expected, &STATE);
    Ok(())
}

fn compare_associations(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let file = "jpda.json";
    let Some(path) = part.find(file) else { return Ok(()) };
    for (number, case) in document::<Associations>(&path)?.cases.iter().enumerate() {
        let (track_count, detection_count) = (case.tracks.len(), case.meas.len());
        let d2 = rows(&path, &format!("case {number}, d2"), &case.d2, [track_count, detection_count])?;
        let beta =
            rows(&path, &format!("case {number}, beta"), &case.beta, [track_count, detection_count + 1])?;
        let [found_d2, found_beta] =
            case.associate().map_err(|error| VerifyError::caused(&path, &format!("case {number}"), error))?;
        let vector = |what: &str| part.vector(file, &format!("{number}.{what}"));
        ledger.compare(vector("d2"), &[track_count, detection_count], &found_d2, &d2, &EXACT);
        ledger.compare(vector("beta"), &[track_count, detection_count + 1], &found_beta, &beta, &EXACT);
    }
    Ok(())
}

impl AssociationCase {
    /// Squared distances and probabilities, track by track.
    fn associate(&self) -> Result<[Vec<f64>; 2], JpdaFault> {
        let d2 = |track: usize, detection: usize| {
            let off = Vector2::from(self.meas[detection]) - Vector2::from(self.tracks[track]);
            off.norm_squared() / self.innovation_variance
        };
        let sensor =
            Sensor { detection_probability: self.detection_probability, clutter_density: self.clutter };
        let log_root_det = (std::f64::consts::TAU * self.innovation_variance).ln();
        let log_likelihood = |track: usize, detection: usize| {
            let d2 = d2(track, detection);
            (d2 <= self.gate).then_some(-0.5 * d2 - log_root_det)
        };
        let (track_count, detection_count) = (self.tracks.len(), self.meas.len());
        let association = JointAssociation::new(track_count, detection_count, &sensor, log_likelihood)?;
        let pairs = (0..track_count).flat_map(|track| (0..detection_count).map(move |j| (track, j)));
        let beta = (0..track_count).flat_map(|track| association.of_track(track).iter().copied());
        Ok([pairs.map(|(track, detection)| d2(track, detection)).collect(), beta.collect()])
    }
}

fn compare_samples(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let file = "sample_prior.json";
    let Some(path) = part.find(file) else { return Ok(()) };
    let Samples { step, samples, queries } = document(&path)?;
    let wrong = |reason: String| VerifyError::malformed(&path, reason);
    let step_count = samples.first().map_or(0, Vec::len);
    if step_count < 2 || samples.iter().any(|sample| sample.len() != step_count) {
        return Err(wrong("samples are not two or more states each, equally many".to_owned()));
    }
    let [mut means, mut covariances] = [const { Vec::new() }; 2];
    for query in &queries {
        let at = query.tau / step;
        if !(0.0..=(step_count - 1) as f64).contains(&at) {
            return Err(wrong(format!("tau {} lies beyond the samples", query.tau)));
        }
        let before = (at.floor() as usize).min(step_count - 2);
        let share = at - before as f64;
        let point = |sample: &Vec<[f64; 5]>| {
            interpolated(&sample[before].into(), &sample[before + 1].into(), share, STATE.angles)
        };
        let points: Vec<Vector5<f64>> = samples.iter().map(point).collect();
        let found = sample_moments(&points, STATE.angles);
        means.extend(found.mean.iter());
        // Symmetric, so column-major equals row-major.
        covariances.extend(found.covariance.iter());
    }
    let expected: Vec<_> = queries.iter().flat_map(|query| query.mean).collect();
    ledger.compare(part.vector(file, "mean"), &[queries.len(), 5], &means, &expected, &STATE);
    let expected: Vec<_> = queries.iter().flat_map(|query| query.cov.as_flattened()).copied().collect();
    ledger.compare(part.vector(file, "cov"), &[queries.len(), 5, 5], &covariances, &expected, &EXACT);
    Ok(())
}

/// The numbers of rows of equal length. The shape is checked.
fn rows(path: &Path, name: &str, rows: &[Vec<f64>], shape: [usize; 2]) -> Result<Vec<f64>, VerifyError> {
    let [row_count, row_len] = shape;
    if rows.len() != row_count || rows.iter().any(|row| row.len() != row_len) {
        let reason = format!("{name} is not {row_count} rows of {row_len}");
        return Err(VerifyError::malformed(path, reason));
    }
    Ok(rows.concat())
}
