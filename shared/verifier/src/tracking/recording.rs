use filters::{Filter, Gaussian, Motion, Observation, Process};

use super::figures::{Sample, Truth};
use super::ledger::{EXACT, Ledger, Rule};
use super::part::Part;
use super::table::Table;
use crate::VerifyError;

/// The measurement of a track at one tick.
pub(super) struct Tick {
    track: u64,
    k: u64,
    visible: bool,
    pub(super) position_m: [f64; 2],
    pub(super) heading_rad: f64,
}

/// A filter and its reference.
pub(super) struct Run<P, const N: usize> {
    /// Start of the file's name.
    pub(super) file: &'static str,
    /// The reference's deviation from the truth, if given.
    pub(super) figures: Option<[f64; 8]>,
    pub(super) process: P,
    pub(super) start: fn(&Tick) -> [f64; N],
    pub(super) start_variance: [f64; N],
    pub(super) heading_variance: Option<f64>,
    /// The filter of this kind.
    pub(super) filter: fn(Gaussian<N>) -> Filter,
}

/// A filter's estimates after each tick.
#[derive(Default)]
struct Estimates {
    means: Vec<f64>,
    /// Upper triangles, row by row.
    covariances: Vec<f64>,
    /// NaN if nothing was updated.
    nis: Vec<f64>,
    /// `None` before the first detection.
    motions: Vec<Option<Motion>>,
}

/// The measurements, and the true motion if it is given.
pub(super) struct Recording {
    /// Ending of the names of its files.
    end: String,
    dt_ns: u64,
    position_variance: f64,
    burn_in_ticks: u64,
    ticks: Vec<Tick>,
    truth: Option<Truth>,
}

impl Recording {
    pub(super) fn read(
        part: &mut Part,
        dt_s: f64,
        position_variance: f64,
        burn_in_ticks: u64,
    ) -> Result<Self, VerifyError> {
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
        Ok(Self { end, dt_ns, position_variance, burn_in_ticks, ticks, truth })
    }

    /// Compares a run, if its reference exists.
    pub(super) fn compare<P: Process<N>, const N: usize>(
        &self,
        run: &Run<P, N>,
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
        if let (Some(truth), Some(expected)) = (&self.truth, run.figures) {
            let name = part.vector(&file, "figures");
            ledger.compare(name, &[expected.len()], &self.figures(truth, &found), &expected, &EXACT);
        }
        Ok(())
    }

    /// The figures of the odd tracks, to which the reference's figures refer.
    fn figures(&self, truth: &Truth, estimates: &Estimates) -> [f64; 8] {
        let rows = self.ticks.iter().zip(&estimates.motions).zip(&estimates.nis).enumerate();
        let samples = rows.map(|(at, ((tick, motion), nis))| Sample {
            at,
            visible: tick.visible,
            burnt_in: tick.k >= self.burn_in_ticks,
            motion: motion.as_ref(),
            nis: *nis,
        });
        truth.figures(samples.filter(|sample| self.ticks[sample.at].track % 2 == 1))
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

    /// Predicts and, if there is a detection, updates. Returns the NIS. A failed step leaves the state as it
    /// is, so that the comparison reveals the failure.
    fn advance<P: Process<N>, const N: usize>(
        &self,
        run: &Run<P, N>,
        state: &mut Gaussian<N>,
        tick: &Tick,
    ) -> f64 {
        let heading_rad = run.heading_variance.map(|variance| (tick.heading_rad, variance));
        let position = Observation::of_position(tick.position_m, self.position_variance);
        let seen = Observation { heading_rad, ..position };
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

/// Checks that a table has one row per tick, in order.
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
