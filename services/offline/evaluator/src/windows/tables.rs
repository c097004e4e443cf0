//! Tables: a row per method and measure, a column per part of the data.

use metrics::Errors;

use super::{COMPARED, Calibration, Group, Measure, Method, PaperRow, Tally};
use crate::table::{Entry, RESAMPLES, Row, Table, pair};

/// The methods in a summary.
const SUMMARISED: [&str; 9] = [
    Method::Network.name(),
    Method::OnlineRetrieval.name(),
    Method::WarmStartedRetrieval.name(),
    Method::Evidence.name(),
    Method::Base.name(),
    Method::Anchors.name(),
    Method::ConstantVelocity.name(),
    "STG-DAT (paper)",
    "STG-DAT T+C+K (paper)",
];

/// Caption of the tables of calibration and plausibility.
const RATES: &str = "KDE-NLL: negative log density of the truth under a kernel density of the 20 modes, weighted by their probabilities. Coverage: \
                     share of truths inside the highest-density region of the mixture of Gaussians, over agents and steps. Collision: the \
                     discs of two agents meet, 0.9 m around vehicles, 0.3 m around cyclists, 0.2 m around pedestrians. Limits are those of \
                     `metrics::Limits`, checked on all modes and K = 1.";

/// The rows of the tables of errors by horizon.
const GROWTH: [(Measure, Method); 5] = [
    (Measure::BestOf, Method::Network),
    (Measure::BestOf, Method::Base),
    (Measure::BestOf, Method::Anchors),
    (Measure::Single, Method::Network),
    (Measure::Single, Method::ConstantVelocity),
];

/// A column: the mean over its groups.
#[derive(Clone, Debug)]
pub(crate) struct Column<'a> {
    pub(crate) name: String,
    pub(crate) groups: Vec<&'a Group>,
}

impl<'a> Column<'a> {
    /// A column of one group.
    pub(crate) fn of(name: &str, group: &'a Group) -> Self {
        Self { name: name.to_owned(), groups: vec![group] }
    }

    fn errors(&self, method: Method, measure: Measure, horizon: usize) -> Option<Errors> {
        let errors = self.groups.iter().map(|group| group.total.errors(method, measure, horizon));
        let errors: Vec<Errors> = errors.collect::<Option<_>>()?;
        let mean = |of: fn(&Errors) -> f64| errors.iter().map(of).sum::<f64>() / errors.len() as f64;
        (!errors.is_empty()).then(|| Errors { ade_m: mean(|e| e.ade_m), fde_m: mean(|e| e.fde_m) })
    }
}

impl Table {
    /// The table's rows for a summary; `None` unless the table is a main table.
    pub(crate) fn summary(&self) -> Option<Self> {
        let is_included =
            |row: &&Row| self.is_brief || row.names.get(1).is_none_or(|name| SUMMARISED.contains(&&name[..]));
        let rows = self.rows.iter().filter(is_included);
        let rows = rows.filter(|row| row.names[0] != Measure::JointRanked.name());
        self.is_main.then(|| Self { rows: rows.cloned().collect(), ..self.clone() })
    }

    /// ADE / FDE of every method and measure at one horizon.
    pub(crate) fn errors(title: &str, note: &str, columns: &[Column<'_>], horizon: usize) -> Self {
        let mut table = Self::new(title, note, &["measure", "method"], names(columns));
        for measure in Measure::ALL {
            for method in Method::ALL {
                let cells = columns.iter().map(|column| column.errors(method, measure, horizon).map(pair));
                table.push_known(&[measure.name(), method.name()], cells);
            }
        }
        table
    }

    /// The published forecasts and constant velocity; one row per group with agents.
    pub(crate) fn published(title: &str, note: &str, groups: &[&Group], horizon: usize) -> Self {
        let head =
            ["forecasts", "published", "constant velocity", "ratio of FDE", "published, minADE₂₀ / minFDE₂₀"];
        let mut table = Self::new(title, note, &["agents"], head);
        for group in groups {
            let errors = |method, measure| group.total.errors(method, measure, horizon);
            let single = errors(Method::Evidence, Measure::Single);
            let [Some(ours), Some(plain)] = [single, errors(Method::ConstantVelocity, Measure::Single)]
            else {
                continue;
            };
            let ratio = (plain.fde_m > 0.0).then(|| Entry::number(ours.fde_m / plain.fde_m, 2));
            let best = errors(Method::Evidence, Measure::BestOf).map(pair);
            let forecasts = Entry::count(group.total.len(Method::Evidence, Measure::Single) as usize);
            let figures = [Some(forecasts), Some(pair(ours)), Some(pair(plain)), ratio, best];
            table.push(&[group.subset.name()], figures);
        }
        table
    }

    /// The rows of our own forecasts in a main table, followed by the same rows by other weights. Each row
    /// contains the name of its training.
    pub(crate) fn by_training(&self, name: &str, others: &[(&str, &Self)]) -> Option<Self> {
        let rows = self.rows.iter().enumerate().flat_map(|(place, row)| {
            let ours = Method::OURS
                .iter()
                .filter(|method| row.names.get(1).is_some_and(|name| name == method.name()));
            ours.flat_map(move |method| {
                let trainings = std::iter::once((name, self)).chain(others.iter().copied());
                trainings.filter_map(move |(name, table)| {
                    let mut row = table.rows.get(place)?.clone();
                    row.names[1] = format!("{}, {name}", method.name());
                    Some(row)
                })
            })
        });
        self.is_main.then(|| Self {
            title: format!("{}, training by training", self.title),
            rows: rows.collect(),
            is_brief: true,
            ..self.clone()
        })
    }

    /// ADE / FDE of some methods at all horizons, for one column after the other.
    pub(crate) fn horizons(title: &str, columns: &[Column<'_>], horizons_s: &[f64]) -> Self {
        let horizon = |column: &Column<'_>| {
            let name = column.name.clone();
            horizons_s.iter().map(move |s| format!("{name} {s:.1} s")).collect::<Vec<_>>()
        };
        let columns_of = columns.iter().flat_map(horizon);
        let mut table = Self::new(title, "", &["measure", "method"], columns_of);
        for (measure, method) in GROWTH {
            let cells = columns.iter().flat_map(|column| {
                (0..horizons_s.len()).map(|horizon| column.errors(method, measure, horizon).map(pair))
            });
            table.push_known(&[measure.name(), method.name()], cells);
        }
        table
    }

    /// Adds the rows of the paper's methods. `cell` returns the entry of a method and column.
    pub(crate) fn add_paper<'a>(
        &mut self,
        paper: &'a [PaperRow],
        column_count: usize,
        cell: impl Fn(&'a [PaperRow], &str, usize) -> Option<Errors>,
    ) {
        for method in crate::windows::reference::methods(paper) {
            let cells = (0..column_count).map(|column| cell(paper, method, column).map(pair));
            self.push_known(&[Measure::BestOf.name(), &format!("{method} (paper)")], cells);
        }
    }

    /// Miss rates, densities, coverage, collisions and violated limits at one horizon.
    /// `of` names the agents after a colon, if there are tables of others.
    pub(crate) fn rates(of: &str, columns: &[Column<'_>], horizon: usize) -> Self {
        let title = format!("Calibration and plausibility{of}");
        let mut table = Self::new(&title, RATES, &["share", "method"], names(columns));
        let of_columns: Vec<Vec<Vec<Rate>>> = columns
            .iter()
            .map(|column| column.groups.iter().map(|group| rates(&group.total, horizon)).collect())
            .collect();
        let all = rates(&Tally::new(horizon + 1), horizon);
        for (row, &Rate { name, method, decimals, .. }) in all.iter().enumerate() {
            let cell = |groups: &Vec<Vec<Rate>>| {
                let values: Option<Vec<f64>> = groups.iter().map(|rates| rates[row].value).collect();
                let values = values.filter(|values| !values.is_empty())?;
                Some(Entry::number(values.iter().sum::<f64>() / values.len() as f64, decimals))
            };
            table.push_known(&[name, method.name()], of_columns.iter().map(cell));
        }
        table
    }

    /// Our errors at the longest horizon compared with the errors of baselines, with 95 % intervals.
    /// `of` is as in [`Table::rates`].
    pub(crate) fn comparisons(of: &str, columns: &[Column<'_>]) -> Self {
        let note = format!(
            "Difference of the errors (ADE / FDE) on the same agents, ours minus the baseline's, in % of the baseline's. Negative: \
             ours is better; significant where the whole 95 % interval is below 0. Paired bootstrap, {RESAMPLES} resamples \
             of blocks as long as one window."
        );
        let title = format!("Comparison with baselines{of}");
        let mut table = Self::new(&title, &note, &["measure", "against"], names(columns));
        for (place, (measure, method)) in COMPARED.into_iter().enumerate() {
            let cell = |column: &Column<'_>| {
                let [group] = column.groups[..] else { return None };
                let pair = group.compare(place)?;
                Some(Entry::from(pair.map(|contrast| Entry::percent(contrast.ratio).text).join(" / ")))
            };
            table.push_known(&[measure.name(), method.name()], columns.iter().map(cell));
        }
        table
    }
}

fn names(columns: &[Column<'_>]) -> impl Iterator<Item = String> {
    columns.iter().map(|column| column.name.clone())
}

/// A figure of our forecasts that is not an error.
pub(crate) struct Rate {
    pub(crate) name: &'static str,
    pub(crate) method: Method,
    pub(crate) value: Option<f64>,
    decimals: usize,
}

/// Our forecasts' figures that are not errors, and the numbers of scenes and agents.
pub(crate) fn rates(tally: &Tally, horizon: usize) -> Vec<Rate> {
    let rate = |name, method, value: Option<f64>, decimals: usize| Rate { name, method, value, decimals };
    let count = |name, len: u64| rate(name, Method::Network, Some(len as f64), 0);
    let percent = |name, method, share: &metrics::Share| {
        rate(name, method, share.value().map(|share| 100.0 * share), 1)
    };
    let calibration =
        Method::OURS.iter().enumerate().map(|(ours, &method)| (method, tally.calibration(ours, horizon)));
    let mut rates = vec![count("scenes", tally.scene_count), count("agents", tally.agents_len)];
    rates.extend(calibration.clone().map(|(method, of)| rate("KDE-NLL", method, of.kde_nll.value(), 3)));
    let mut shares = |name, share: fn(&Calibration) -> &metrics::Share| {
        rates.extend(calibration.clone().map(|(method, of)| percent(name, method, share(&of))));
    };
    shares("coverage of the 50 % region, %", |of| &of.covered_50);
    shares("coverage of the 90 % region, %", |of| &of.covered_90);
    shares("miss rate (2 m), minFDE₂₀, %", |of| &of.missed_best);
    shares("miss rate (2 m), K = 1, %", |of| &of.missed_single);
    rates.extend([
        percent("collision rate, K = 1 forecasts, %", Method::Network, &tally.collided),
        percent("collision rate, recorded futures, %", Method::Network, &tally.truly_collided),
    ]);
    let broken = Method::OURS.iter().zip(&tally.broken);
    rates
        .extend(broken.map(|(&method, broken)| percent("forecasts that violate a limit, %", method, broken)));
    rates
}
