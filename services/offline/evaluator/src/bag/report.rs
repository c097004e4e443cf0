//! The table of a comparison.

use metrics::{Displacement, DisplacementMean, Errors, Share};
use wire::{AGENT_TYPES, AgentType};

use crate::page::Page;
use crate::table::{Entry, Table, pair};

/// Levels of the regions whose coverage is reported.
pub(crate) const LEVELS: [f64; 2] = [0.5, 0.9];

/// The compared forecasts.
pub(crate) const METHODS: [&str; 6] = [
    // Our single best forecast.
    "stgdat",
    // The bag's path of the highest confidence.
    "bag",
    // Constant velocity of our track.
    "constant velocity",
    // The best of our most probable modes. There are as many of them as the bag has paths.
    "stgdat, best of as many",
    "bag, best of its paths",
    "stgdat, best of 20",
];

/// What was compared and what was not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Counts {
    /// Messages that were compared.
    pub messages: u64,
    /// Messages without a tick of ours at most one interval before.
    pub messages_outside: u64,
    /// Forecasts that were compared.
    pub forecasts: u64,
    /// Our forecasts without an object of the bag.
    pub only_ours: u64,
    /// Objects of the bag without a forecast of ours.
    pub only_theirs: u64,
    /// Objects of the bag whose paths are all shorter than the horizon.
    pub short: u64,
    /// Forecasts whose agent was not seen over the whole horizon.
    pub without_truth: u64,
    /// Objects of other classes.
    pub other: u64,
}

/// Means over forecasts.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    /// By [`METHODS`].
    errors: [DisplacementMean; METHODS.len()],
    held: [Share; LEVELS.len()],
}

/// Sums by type and horizon.
pub(crate) struct Cells {
    horizons: [usize; 4],
    /// \[type, horizon\]; the last type is all of them.
    cells: [[Cell; 4]; AGENT_TYPES.len() + 1],
}

/// The errors of one type over one horizon.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// The type; `all` for all types.
    pub(crate) agents: &'static str,
    pub(crate) horizon_s: f64,
    pub(crate) forecasts: u64,
    /// By [`METHODS`].
    pub(crate) errors: [Errors; METHODS.len()],
    /// Share of truths within our regions of 50 % and 90 % at the end of the horizon; a bag has no regions.
    pub(crate) within: Option<[f64; LEVELS.len()]>,
}

/// A bag's forecasts and ours.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AgainstReport {
    pub(crate) counts: Counts,
    pub(crate) rows: Vec<Row>,
    /// Largest number of paths of an object in the bag.
    pub(crate) paths_max: usize,
    /// Whether the truth is the recording's own.
    pub(crate) is_truth_recorded: bool,
}

impl Cells {
    /// For a comparison of this many steps.
    pub fn new(steps_len: usize) -> Self {
        let horizons = [1, 2, 3, 4].map(|quarter| (steps_len * quarter).div_ceil(4));
        Self { horizons, cells: Default::default() }
    }

    /// Numbers of steps.
    pub const fn horizons(&self) -> [usize; 4] {
        self.horizons
    }

    /// Adds a forecast: its errors, and the level of our region whose border passes through the truth.
    pub fn add(
        &mut self,
        agent_type: AgentType,
        horizon: usize,
        errors: &[Displacement; METHODS.len()],
        level: Option<f64>,
    ) {
        for of_type in [agent_type.index(), AGENT_TYPES.len()] {
            let cell = &mut self.cells[of_type][horizon];
            cell.errors.iter_mut().zip(errors).for_each(|(mean, errors)| mean.add(*errors));
            for (held, of) in cell.held.iter_mut().zip(LEVELS) {
                level.into_iter().for_each(|level| held.add(level <= of));
            }
        }
    }

    pub fn rows(&self, step_ns: i64) -> Vec<Row> {
        let names = AGENT_TYPES.map(AgentType::name).into_iter().chain(["all"]);
        let rows = names.zip(&self.cells).flat_map(|(agents, cells)| {
            let mut horizons: Vec<(usize, &Cell)> = self.horizons.into_iter().zip(cells).collect();
            // A short comparison has fewer than four horizons.
            horizons.dedup_by_key(|(steps, _)| *steps);
            horizons
                .into_iter()
                .filter_map(move |(steps, cell)| row(agents, (step_ns * steps as i64) as f64 / 1e9, cell))
        });
        rows.collect()
    }
}

fn row(agents: &'static str, horizon_s: f64, cell: &Cell) -> Option<Row> {
    let mean = |of: DisplacementMean| Some(Errors { ade_m: of.ade_m.value()?, fde_m: of.fde_m.value()? });
    let [half, most] = cell.held.map(|share| share.value());
    Some(Row {
        agents,
        horizon_s,
        forecasts: cell.errors[0].ade_m.len(),
        errors: cell.errors.map(mean).into_iter().collect::<Option<Vec<_>>>()?.try_into().ok()?,
        within: half.zip(most).map(<[f64; LEVELS.len()]>::from),
    })
}

impl Counts {
    /// The counts in words.
    pub(crate) fn text(&self) -> String {
        let Self {
            messages,
            messages_outside,
            forecasts,
            only_ours,
            only_theirs,
            short,
            without_truth,
            other,
        } = self;
        format!(
            "{forecasts} forecasts in {messages} messages; not compared: {only_ours} forecasts of stgdat without an object of \
             the bag, {only_theirs} objects without a forecast of stgdat, {short} with shorter paths, {without_truth} \
             without truth over the whole horizon, {other} of other classes; {messages_outside} messages outside the \
             recording"
        )
    }
}

impl AgainstReport {
    /// A table of the rows that are `shown`.
    fn table(&self, is_shown: impl Fn(&Row) -> bool) -> Table {
        let truth =
            if self.is_truth_recorded { "the recording's own tracks" } else { "the later tracks of stgdat" };
        let note = format!("ADE / FDE, m. Best of: the path with the least error. Truth: {truth}.");
        let mut methods = METHODS.map(str::to_owned);
        methods[4] = format!("bag, best of {}", self.paths_max);
        let columns = ["s", "forecasts"].map(str::to_owned).into_iter().chain(methods);
        let columns = columns.chain(["stgdat, truth within 50 / 90 %".to_owned()]);
        let mut table = Table::new("Forecasts of stgdat and of the bag", &note, &["agents"], columns);
        for row in self.rows.iter().filter(|row| is_shown(row)) {
            let counts = [Entry::number(row.horizon_s, 1), Entry::count(row.forecasts as usize)];
            let within = row.within.map(|[half, most]| {
                let text = format!("{:.0} / {:.0} %", 100.0 * half, 100.0 * most);
                Entry::new(text, [("50 %", half), ("90 %", most)])
            });
            let entries = counts.into_iter().chain(row.errors.map(pair)).map(Some).chain([within]);
            table.push(&[row.agents], entries);
        }
        table.closing = format!("{}.", self.counts.text());
        table
    }

    /// The report in all its forms. The Markdown contains every type over the longest horizon, and all agents over
    /// all horizons.
    pub(crate) fn page(&self) -> Page {
        let end_s = self.rows.iter().map(|row| row.horizon_s).fold(0.0, f64::max);
        let shown = self.table(|row| row.agents == "all" || row.horizon_s == end_s);
        let page = Page::of("against bag", "evaluate --against-bag", &[self.table(|_| true)]);
        let page = page.with("counts", self.counts).with("is_truth_recorded", self.is_truth_recorded);
        let markdown = shown.section("##", "");
        Page { summary: markdown.clone(), markdown, ..page }
    }
}
