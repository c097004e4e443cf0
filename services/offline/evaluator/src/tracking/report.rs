//! The report on the filters' errors.

use metrics::tracking::{Consistency, ConsistencySummary, ErrorNorms};
use metrics::{PairedErrors, paired_bootstrap_ratio};

use super::{Error, Outcome, Sensor, TRIALS, TrackingMethod, Trials};
use crate::forecaster::Provenance;
use crate::page::Page;
use crate::table::{Entry, RESAMPLES, SEED, Table, digits};

/// Probability within the χ² bounds of the normalised squares.
const BOUNDS: f64 = 0.95;
/// The noise whose errors a summary contains, m. With it a constant-velocity filter has about the error of
/// the paper.
const SUMMARISED_M: f64 = 0.02;

/// The errors of one method under one sensor.
#[derive(Clone, Debug)]
pub(crate) struct MethodErrors {
    sensor: Sensor,
    method: TrackingMethod,
    /// The errors of each track.
    tracks: Vec<Vec<Error>>,
    /// Consistency of the positions that the column reports, and of the innovations; `None` if there are
    /// none.
    nees: Option<ConsistencySummary>,
    nis: Option<ConsistencySummary>,
    fault_count: u64,
}

/// The result of an evaluation of tracking.
#[derive(Clone, Debug)]
pub(crate) struct TrackingReport {
    provenance: Provenance,
    evaluated_s: f64,
    tuned_s: f64,
    evaluated: Vec<MethodErrors>,
    trials: Vec<(f64, Trials)>,
}

wire::named! {
    /// An estimated quantity.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Quantity {
        Position => "position, m",
        Velocity => "velocity, m/s",
    }
}

impl Quantity {
    /// The heading of the quantity's table.
    const fn title(self) -> &'static str {
        match self {
            Self::Position => "Position error, m",
            Self::Velocity => "Velocity error, m/s",
        }
    }

    const fn of(self, error: &Error) -> f64 {
        match self {
            Self::Position => error.position_m,
            Self::Velocity => error.velocity_mps,
        }
    }
}

impl MethodErrors {
    /// The outcomes of all recordings together. For the χ² bounds, vehicles at the same tick number are
    /// parallel runs.
    pub(crate) fn new<'a>(
        sensor: Sensor,
        method: TrackingMethod,
        outcomes: impl Iterator<Item = &'a Outcome>,
    ) -> Self {
        let (mut tracks, mut fault_count) = (Vec::new(), 0);
        let (mut nees, mut nis) = (Consistency::default(), Consistency::default());
        for outcome in outcomes {
            let mut errors = outcome.errors.clone();
            // The sort is stable, so instants remain in order.
            errors.sort_by_key(|error| error.id);
            tracks.extend(errors.chunk_by(|a, b| a.id == b.id).map(<[Error]>::to_vec));
            nees.merge(&outcome.nees[usize::from(sensor.gap_s > 0.0)]);
            nis.merge(&outcome.nis);
            fault_count += outcome.fault_count;
        }
        let [nees, nis] = [nees, nis].map(|squares| squares.summary(BOUNDS).ok().flatten());
        Self { sensor, method, tracks, nees, nis, fault_count }
    }

    /// Whether a column counts an error: only occluded instants if there are gaps, otherwise all.
    fn counts(&self, error: &Error) -> bool {
        error.visible == (self.sensor.gap_s == 0.0)
    }

    fn norms(&self, quantity: Quantity) -> ErrorNorms {
        let mut norms = ErrorNorms::default();
        let errors = self.tracks.iter().flatten().filter(|error| self.counts(error));
        errors.for_each(|error| norms.add(quantity.of(error)));
        norms
    }

    /// Summed errors of each track, paired with another method's errors at the same instants.
    fn paired(&self, other: &Self, quantity: Quantity) -> Vec<PairedErrors> {
        let of_track = |(ours, theirs): (&Vec<Error>, &Vec<Error>)| {
            let mut sum = PairedErrors::default();
            for (ours, theirs) in ours.iter().zip(theirs).filter(|(error, _)| self.counts(error)) {
                sum.add(quantity.of(ours), quantity.of(theirs));
            }
            sum
        };
        self.tracks.iter().zip(&other.tracks).map(of_track).collect()
    }
}

impl TrackingReport {
    pub(crate) const fn new(provenance: Provenance, evaluated_s: f64, tuned_s: f64) -> Self {
        Self { provenance, evaluated_s, tuned_s, evaluated: Vec::new(), trials: Vec::new() }
    }

    pub(crate) fn add(&mut self, evaluated: Vec<MethodErrors>) {
        self.evaluated.extend(evaluated);
    }

    pub(crate) fn add_trials(&mut self, sigma_m: f64, trials: Trials) {
        self.trials.push((sigma_m, trials));
    }

    /// The sensors with this noise, one per column.
    fn sensors(&self, sigma_m: f64) -> Vec<Sensor> {
        let mut sensors: Vec<Sensor> =
            self.evaluated.iter().map(|of| of.sensor).filter(|sensor| sensor.sigma_m == sigma_m).collect();
        sensors.dedup();
        sensors
    }

    fn of(&self, sensor: Sensor, method: TrackingMethod) -> Option<&MethodErrors> {
        self.evaluated.iter().find(|evaluated| evaluated.sensor == sensor && evaluated.method == method)
    }

    /// The methods, in the order of the tables.
    fn methods(&self) -> impl Iterator<Item = TrackingMethod> + '_ {
        self.trials.first().into_iter().flat_map(|(_, trials)| &trials.figures).map(|&(method, _)| method)
    }

    /// The kinematic filter with the least mean error.
    fn best_kinematic(&self, sensor: Sensor, quantity: Quantity) -> Option<&MethodErrors> {
        let kinematic = TrackingMethod::ALL.into_iter().filter(|method| method.is_kinematic());
        let evaluated = kinematic.filter_map(|method| self.of(sensor, method));
        let mae = |evaluated: &&MethodErrors| evaluated.norms(quantity).mae().unwrap_or(f64::INFINITY);
        evaluated.min_by(|a, b| mae(a).total_cmp(&mae(b)))
    }

    fn columns(&self) -> Vec<String> {
        let Some(&(sigma_m, _)) = self.trials.first() else { return Vec::new() };
        let name = |sensor: &Sensor| match sensor.gap_s {
            0.0 => "no gaps".to_owned(),
            gap_s => format!("in gaps of {gap_s} s"),
        };
        self.sensors(sigma_m).iter().map(name).collect()
    }

    /// The report in all its forms. The summary has the errors at one noise and the comparisons at all.
    pub(crate) fn page(&self) -> Page {
        let is_reported = |sigma_m: f64| sigma_m == SUMMARISED_M;
        let [position, velocity] = Quantity::ALL.map(|quantity| self.errors(quantity, is_reported));
        let mut tables: Vec<Table> = Quantity::ALL.map(|quantity| self.errors(quantity, |_| true)).into();
        tables.extend([self.comparisons(), self.certainty(), self.settings()]);
        let main = [position, velocity, self.comparisons()];
        let closing = format!("Forecasts of the learned prior: {}", self.provenance.line());
        Page::of("interaction", "evaluate tracking --parts interaction", &tables)
            .titled("Tracking: INTERACTION's vehicles from noisy positions", &tables, &main, &closing)
            .with("provenance", &self.provenance)
    }

    fn errors(&self, quantity: Quantity, is_reported: impl Fn(f64) -> bool) -> Table {
        let note = format!(
            "RMSE / MAE; columns with gaps count the occluded instants alone. Positions are measured at 10 Hz with \
             Gaussian noise of the given standard deviation per axis. A vehicle's first gap begins 3 to 7 s after it \
             appears, each later one 4 s after the end of the last. {} s from the middle of each recording; the reference \
             velocity is the central difference of the recorded positions. Tracks count from an age of 1 s. Learned: \
             every step of the model, forecasts from the filter's own estimates become its prior; their controls \
             fade in, and gaps keep the last forecast. Warm-started retrieval: the forecasts also use the retrieval \
             memory, which begins with the site's training recordings. Smoother bound (oracle): a smoother that uses \
             all measurements of a vehicle, later ones too, which no filter has.",
            self.evaluated_s
        );
        let mut table = Table::new(quantity.title(), &note, &["deviation", "method"], self.columns());
        for &(sigma_m, _) in self.trials.iter().filter(|(sigma_m, _)| is_reported(*sigma_m)) {
            for method in self.methods() {
                let cell = |sensor: Sensor| {
                    let norms = self.of(sensor, method)?.norms(quantity);
                    let (rmse, mae) = (norms.rmse()?, norms.mae()?);
                    let numbers = [("RMSE", rmse), ("MAE", mae), ("instants", norms.len as f64)];
                    Some(Entry::new(format!("{} / {}", fine(rmse), fine(mae)), numbers))
                };
                table.push(&[&deviation(sigma_m), method.name()], self.cells(sigma_m, cell));
            }
        }
        table
    }

    /// One cell per sensor with this noise.
    fn cells(
        &self,
        sigma_m: f64,
        cell: impl Fn(Sensor) -> Option<Entry>,
    ) -> impl Iterator<Item = Option<Entry>> {
        self.sensors(sigma_m).into_iter().map(cell)
    }

    fn comparisons(&self) -> Table {
        let note = format!(
            "Mean error of the learned prior less that of the reference on the same instants, in % of the latter: negative \
             where the learned prior is better. In brackets the 95 % interval of a paired bootstrap over tracks, \
             {RESAMPLES} resamples. The best kinematic filter is chosen cell by cell from these very figures, which \
             favours it."
        );
        let head = ["deviation", "method", "quantity, reference"];
        let mut table = Table::new("Learned prior against the other filters", &note, &head, self.columns());
        for &(sigma_m, _) in &self.trials {
            for learned in self.methods().filter(|method| method.is_learned()) {
                for quantity in Quantity::ALL {
                    let against = |sensor: Sensor, other: Option<&MethodErrors>| {
                        let paired = self.of(sensor, learned)?.paired(other?, quantity);
                        Some(Entry::percent(paired_bootstrap_ratio(&paired, RESAMPLES, SEED)?))
                    };
                    let best = |sensor| against(sensor, self.best_kinematic(sensor, quantity));
                    let velocity =
                        |sensor| against(sensor, self.of(sensor, TrackingMethod::ConstantVelocity));
                    let name = quantity.name().split(',').next().unwrap_or_default();
                    let mut push = |other: &str, cell: &dyn Fn(Sensor) -> Option<Entry>| {
                        let compared = format!("{name}, {other}");
                        let names = [&deviation(sigma_m), learned.name(), &compared];
                        table.push(&names, self.cells(sigma_m, cell));
                    };
                    push("best kinematic filter", &best);
                    push("constant velocity", &velocity);
                }
            }
        }
        table
    }

    fn certainty(&self) -> Table {
        let note = "NEES of the position / NIS of the measurements: mean per degree of freedom, 1 where covariances are right \
                    and more where they are too small; in brackets the share of instants at which the sum over all \
                    vehicles lies within its 95 % χ² bounds. Faults are predictions and updates that failed.";
        let columns = self.columns().into_iter().chain(["faults".to_owned()]);
        let mut table = Table::new("Consistency", note, &["deviation", "method"], columns);
        for &(sigma_m, _) in &self.trials {
            for method in self.methods() {
                let cell = |sensor: Sensor| {
                    let evaluated = self.of(sensor, method)?;
                    let (nees, nis) = (evaluated.nees?, evaluated.nis?);
                    let numbers = [
                        ("NEES", nees.per_degree),
                        ("NEES inside", nees.inside),
                        ("NIS", nis.per_degree),
                        ("NIS inside", nis.inside),
                    ];
                    Some(Entry::new(format!("{} / {}", consistency(&nees), consistency(&nis)), numbers))
                };
                let evaluated =
                    self.sensors(sigma_m).into_iter().filter_map(|sensor| self.of(sensor, method));
                let faults = evaluated.map(|evaluated| evaluated.fault_count).sum::<u64>() as usize;
                let cells = self.cells(sigma_m, cell).chain([Some(Entry::count(faults))]);
                table.push(&[&deviation(sigma_m), method.name()], cells);
            }
        }
        table
    }

    fn settings(&self) -> Table {
        let note = format!(
            "Tuned for the least mean negative log-likelihood (NLL) of the measured positions on the validation part: {} s \
             of one recording per site, {TRIALS} trials per method and deviation.",
            self.tuned_s
        );
        let mut table = Table::new("Settings", &note, &["deviation", "method"], ["setting", "NLL"]);
        for (sigma_m, trials) in &self.trials {
            for &(method, figure) in &trials.figures {
                let numbers = method.tuned().iter().zip(trials.settings.of(method));
                let setting: Vec<String> =
                    numbers.map(|((what, _), value)| format!("{what} {value:.3}")).collect();
                let setting = match &setting[..] {
                    [] => format!("those of {}", method.tuned_as().name()),
                    numbers => numbers.join(", "),
                };
                let figures = [setting.into(), Entry::number(figure, 3)];
                table.push(&[&deviation(*sigma_m), method.name()], figures);
            }
        }
        table
    }
}

fn deviation(sigma_m: f64) -> String {
    format!("{sigma_m} m")
}

/// The square per degree of freedom, and the share within the bounds.
fn consistency(squares: &ConsistencySummary) -> String {
    format!("{} ({:.0} %)", digits(squares.per_degree), 100.0 * squares.inside)
}

/// Four decimals below 1, because some errors are millimetres.
fn fine(value: f64) -> String {
    if value < 1.0 { format!("{value:.4}") } else { digits(value) }
}
