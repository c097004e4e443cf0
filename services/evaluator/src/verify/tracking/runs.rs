//! Runs of Kalman filters over recorded measurements.
//!
//! `parameters.json` tells the noise, `meas*.csv` what was measured at every tick of every track; `cv_kf*.csv` and its
//! like hold mean, covariance and normalised innovation squared (NIS) of each filter after each tick. A track's first
//! detection starts it.

use filters::{
    Bicycle, ConstantAcceleration, ConstantVelocity, Filter, Gaussian, Integrator, Motion, Observation,
    Process,
};
use serde::Deserialize;

use super::figures::{self, Figures, Truth};
use super::ledger::{EXACT, Ledger, Rule};
use super::part::{Part, document};
use super::table::Table;
use crate::verify::VerifyError;

/// The step to which the noise of [`Bicycle`] refers, and the longest of a process.
const STEP_S: f64 = 0.08;

/// `parameters.json`; what is told of a filter is there where the filter is.
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

/// Noise of a bicycle in one step, and its first variances.
#[derive(Clone, Copy, Deserialize)]
struct BicycleNoise {
    sig_a: f64,
    sig_bd: f64,
    q_floor: [f64; 5],
    /// Of the first heading, and of every measured one.
    sig_psi: f64,
    #[serde(rename = "Pv0")]
    speed_variance: f64,
    #[serde(rename = "Pb0")]
    slip_variance: f64,
}

/// What is measured of a track at one tick.
struct Tick {
    track: u64,
    k: u64,
    visible: bool,
    position_m: [f64; 2],
    heading_rad: f64,
}

/// A filter, and where its reference stands.
struct Run<P, const N: usize> {
    /// Start of the file's name.
    file: &'static str,
    /// Its key in `parameters.json`.
    key: &'static str,
    process: P,
    start: fn(&Tick) -> [f64; N],
    start_variance: [f64; N],
    heading_variance: Option<f64>,
    /// The filter of that kind.
    filter: fn(Gaussian<N>) -> Filter,
}

/// What a filter tells after each tick.
#[derive(Default)]
struct Estimates {
    means: Vec<f64>,
    /// Upper triangles, row by row.
    covariances: Vec<f64>,
    /// No number (NaN) where nothing was updated.
    nis: Vec<f64>,
    /// `None` before the first detection.
    motions: Vec<Option<Motion>>,
}

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let path = part.expect("parameters.json")?;
    let parameters: Parameters = document(&path)?;
    let wrong = |reason: String| VerifyError::malformed(&path, reason);
    if !(parameters.dt_s > 0.0 && parameters.dt_s <= STEP_S) {
        return Err(wrong(format!("dt_s {} is not above 0 and at most {STEP_S}", parameters.dt_s)));
    }
    let need = |value: Option<f64>, key: &str| value.ok_or_else(|| wrong(format!("{key} is missing")));
    let recording = Recording::read(part, parameters.dt_s, parameters.sigma_m.powi(2))?;

    let position = recording.position_variance;
    if let Some(AxisNoise { q }) = parameters.cv {
        let speed = need(parameters.initial_velocity_variance, "initial_velocity_variance")?;
        let run = Run {
            file: "cv_kf",
            key: "cv",
            process: ConstantVelocity { density: q },
            start: |tick| [tick.position_m[0], tick.position_m[1], 0.0, 0.0],
            start_variance: [position, position, speed, speed],
            heading_variance: None,
            filter: Filter::ConstantVelocity,
        };
        recording.compare(&run, &parameters, part, ledger)?;
    }
    if let Some(AxisNoise { q }) = parameters.ca {
        let speed = need(parameters.initial_velocity_variance, "initial_velocity_variance")?;
        let acceleration = need(parameters.initial_acceleration_variance, "initial_acceleration_variance")?;
        let run = Run {
            file: "ca_kf",
            key: "ca",
            process: ConstantAcceleration { density: q },
            start: |tick| [tick.position_m[0], tick.position_m[1], 0.0, 0.0, 0.0, 0.0],
            start_variance: [position, position, speed, speed, acceleration, acceleration],
            heading_variance: None,
            filter: Filter::ConstantAcceleration,
        };
        recording.compare(&run, &parameters, part, ledger)?;
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
                key: name,
                process: bicycle(&noise, rear_axle_m, parameters.dt_s),
                start: |tick| [tick.position_m[0], tick.position_m[1], tick.heading_rad, 0.0, 0.0],
                start_variance: [position, position, heading, noise.speed_variance, noise.slip_variance],
                heading_variance: measures_heading.then_some(heading),
                filter: Filter::Bicycle,
            };
            recording.compare(&run, &parameters, part, ledger)?;
        }
    }
    Ok(())
}

/// The bicycle whose noise in a step of `dt_s` is the given one; the slip has no limit.
fn bicycle(noise: &BicycleNoise, rear_axle_m: f64, dt_s: f64) -> Bicycle {
    let steps = dt_s / STEP_S;
    Bicycle {
        rear_axle_m,
        integrator: Integrator::Euler,
        acceleration_mps2: noise.sig_a * steps.sqrt(),
        slip_rate_radps: noise.sig_bd * steps.sqrt(),
        floor: noise.q_floor.map(|variance| variance / steps),
        slip_max_rad: f64::INFINITY,
    }
}

/// The measurements, and the true motion where it is told.
struct Recording {
    /// What the names of its files end with.
    end: String,
    dt_ns: u64,
    position_variance: f64,
    ticks: Vec<Tick>,
    truth: Option<Truth>,
}

impl Recording {
    fn read(part: &mut Part, dt_s: f64, position_variance: f64) -> Result<Self, VerifyError> {
        let all: Vec<_> = part.file_names().filter_map(|name| name.strip_prefix("meas")).collect();
        let end = match all.as_slice() {
            [end] => (*end).to_owned(),
            [] => return Err(part.malformed("there is no meas*.csv")),
            _ => return Err(part.malformed("there is more than one meas*.csv for one parameters.json")),
        };
        let ticks = ticks(&Table::read(&part.expect(&format!("meas{end}"))?)?)?;
        let truth = match part.find("truth.csv") {
            Some(path) => {
                let table = Table::read(&path)?;
                check_ticks(&table, &ticks)?;
                Some(Truth::of(&table)?)
            }
            None => None,
        };
        let dt_ns = (dt_s * 1e9).round() as u64;
        Ok(Self { end, dt_ns, position_variance, ticks, truth })
    }

    /// Compares a run, where its reference is there.
    fn compare<P: Process<N>, const N: usize>(
        &self,
        run: &Run<P, N>,
        parameters: &Parameters,
        part: &mut Part,
        ledger: &mut Ledger,
    ) -> Result<(), VerifyError> {
        let file = format!("{}{}", run.file, self.end);
        let Some(path) = part.find(&file) else { return Ok(()) };
        let table = Table::read(&path)?;
        check_ticks(&table, &self.ticks)?;
        let mean_columns: Vec<_> = (0..N).map(|i| format!("m{i}")).collect();
        let covariance_columns: Vec<_> =
            (0..N).flat_map(|i| (i..N).map(move |j| format!("P{i}{j}"))).collect();
        let found = self.follow(run);
        let vectors = [
            ("mean", &found.means, mean_columns, P::ANGLES),
            ("covariance", &found.covariances, covariance_columns, EXACT.angles),
            ("nis", &found.nis, vec!["nis".to_owned()], EXACT.angles),
        ];
        for (what, found, columns, angles) in vectors {
            let expected = table.numbers(&columns)?.concat();
            let shape = [self.ticks.len(), columns.len()];
            ledger.compare(part.vector(&file, what), &shape, found, &expected, &Rule { angles, ..EXACT });
        }
        if let (Some(truth), Some(expected)) =
            (&self.truth, parameters.figures_odd_tracks_after_burn_in.of(run.key))
        {
            let estimates = self.ticks.iter().zip(&found.motions).zip(&found.nis);
            let judged = estimates.enumerate().filter(|(_, ((tick, _), _))| tick.track % 2 == 1);
            let samples = judged.map(|(at, ((tick, motion), nis))| figures::Sample {
                at,
                visible: tick.visible,
                burnt_in: tick.k >= parameters.burn_in_ticks,
                motion: motion.as_ref(),
                nis: *nis,
            });
            let found = truth.figures(samples);
            let name = part.vector(&file, "figures");
            ledger.compare(name, &[expected.len()], &found, &expected, &EXACT);
        }
        Ok(())
    }

    fn follow<P: Process<N>, const N: usize>(&self, run: &Run<P, N>) -> Estimates {
        let mut estimates = Estimates::default();
        let mut state: Option<Gaussian<N>> = None;
        for tick in &self.ticks {
            // Ticks of a track are numbered from 0.
            state = state.filter(|_| tick.k > 0);
            let nis = match &mut state {
                Some(state) => self.advance(run, state, tick),
                None => {
                    let start = || Gaussian::new((run.start)(tick), run.start_variance);
                    state = tick.visible.then(start);
                    f64::NAN
                }
            };
            estimates.nis.push(nis);
            match &state {
                Some(Gaussian { mean, covariance }) => {
                    estimates.means.extend(mean.iter());
                    let upper = (0..N).flat_map(|i| (i..N).map(move |j| covariance[(i, j)]));
                    estimates.covariances.extend(upper);
                }
                None => {
                    estimates.means.extend([f64::NAN; N]);
                    estimates.covariances.extend(std::iter::repeat_n(f64::NAN, N * (N + 1) / 2));
                }
            }
            estimates.motions.push(state.map(|state| (run.filter)(state).motion()));
        }
        estimates
    }

    /// Predicts and, where there is a detection, updates: returns its NIS. A step that fails leaves the state behind, so
    /// that the comparison shows it.
    fn advance<P: Process<N>, const N: usize>(
        &self,
        run: &Run<P, N>,
        state: &mut Gaussian<N>,
        tick: &Tick,
    ) -> f64 {
        let seen = Observation {
            position_m: tick.position_m,
            position_variance: self.position_variance,
            heading_rad: run.heading_variance.map(|variance| (tick.heading_rad, variance)),
            speed_mps: None,
        };
        let moved = state.predict(self.dt_ns, &run.process);
        let updated =
            moved.and_then(|()| tick.visible.then(|| state.update(&seen, &run.process)).transpose());
        updated.ok().flatten().map_or(f64::NAN, |evidence| evidence.nis)
    }
}

fn ticks(table: &Table) -> Result<Vec<Tick>, VerifyError> {
    let tracks = table.whole_numbers("track")?;
    let numbers = table.whole_numbers("k")?;
    let visible = table.whole_numbers("visible")?;
    let measured = table.number_rows(["zx", "zy", "zpsi"])?;
    let mut ticks: Vec<Tick> = Vec::with_capacity(measured.len());
    for (row, [x, y, heading_rad]) in measured.into_iter().enumerate() {
        let (track, k) = (tracks[row], numbers[row]);
        let expected = ticks.last().filter(|last| last.track == track).map_or(0, |last| last.k + 1);
        if k != expected {
            return Err(
                table.malformed(row, format!("tick {k} of track {track} where {expected} comes next"))
            );
        }
        if visible[row] > 1 {
            return Err(table.malformed(row, format!("visible {} is neither 0 nor 1", visible[row])));
        }
        ticks.push(Tick { track, k, visible: visible[row] == 1, position_m: [x, y], heading_rad });
    }
    Ok(ticks)
}

/// Whether a table has a row per tick, in their order.
fn check_ticks(table: &Table, ticks: &[Tick]) -> Result<(), VerifyError> {
    let rows: Vec<_> = table.whole_numbers("track")?.into_iter().zip(table.whole_numbers("k")?).collect();
    let differs = |(row, tick): (&(u64, u64), &Tick)| *row != (tick.track, tick.k);
    if let Some(row) = rows.iter().zip(ticks).position(differs) {
        let ((track, k), tick) = (rows[row], &ticks[row]);
        let reason =
            format!("track {track}, tick {k}, where track {}, tick {}, is measured", tick.track, tick.k);
        return Err(table.malformed(row, reason));
    }
    if rows.len() != ticks.len() {
        return Err(table.malformed_file(format!("{} rows for {} measured ticks", rows.len(), ticks.len())));
    }
    Ok(())
}
