//! Tables as Markdown, and how their figures are written.

use std::collections::BTreeMap;

use metrics::{Errors, Interval, PairedErrors, paired_bootstrap_ratio};

/// Resamples per interval.
pub const RESAMPLES: usize = 1000;
/// Seed of the resamples.
pub(crate) const SEED: u64 = 1;

/// A table of strings.
#[derive(Clone, Debug)]
pub struct Table {
    pub(crate) title: String,
    pub(crate) note: String,
    pub(crate) head: Vec<String>,
    /// Columns of names; they come before the columns of figures.
    pub(crate) name_count: usize,
    pub(crate) rows: Vec<Vec<String>>,
    /// Whether a summary contains the table.
    pub(crate) is_main: bool,
    /// Whether a summary contains all rows.
    pub(crate) is_brief: bool,
}

impl Table {
    /// An empty table. `names` are the titles of its first columns.
    pub fn new(
        title: &str,
        note: &str,
        names: &[&str],
        columns: impl IntoIterator<Item = impl Into<String>>,
    ) -> Self {
        let columns = columns.into_iter().map(Into::into);
        let head = names.iter().map(|name| (*name).to_owned()).chain(columns).collect();
        Self {
            title: title.to_owned(),
            note: note.to_owned(),
            head,
            name_count: names.len(),
            rows: Vec::new(),
            is_main: false,
            is_brief: false,
        }
    }

    /// Marks the table for summaries.
    pub fn main(self) -> Self {
        Self { is_main: true, ..self }
    }

    /// Adds a row: its names, and its figures, `-` for a figure that is unknown.
    pub fn push(&mut self, names: &[&str], figures: impl IntoIterator<Item = Option<String>>) {
        let figures = figures.into_iter().map(|figure| figure.unwrap_or_else(|| "-".to_owned()));
        self.rows.push(names.iter().map(|name| (*name).to_owned()).chain(figures).collect());
    }

    /// Adds a row as [`Table::push`] does, if at least one figure is known.
    pub(crate) fn push_known(&mut self, names: &[&str], figures: impl IntoIterator<Item = Option<String>>) {
        let figures: Vec<Option<String>> = figures.into_iter().collect();
        if figures.iter().any(Option::is_some) {
            self.push(names, figures);
        }
    }

    /// The table as Markdown under a first-level heading. `made` describes the origin of its figures.
    pub fn markdown(&self, made: &str) -> String {
        let space = if self.note.is_empty() { "" } else { " " };
        format!("# {}\n\n{}{space}{made}\n\n{}", self.title, self.note, self.grid())
    }

    /// Only the head and the rows.
    pub fn grid(&self) -> String {
        let column_count = self.head.len();
        let rows = || std::iter::once(&self.head).chain(&self.rows);
        let width = |column: usize| rows().map(|row| row[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..column_count).map(width).collect();
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                // Names are aligned left, figures right.
                if column < self.name_count {
                    format!(" {cell:<width$} |")
                } else {
                    format!(" {cell:>width$} |")
                }
            });
            format!("|{}\n", cells.collect::<String>())
        };
        let rule: String = widths.iter().map(|width| format!("{}|", "-".repeat(width + 2))).collect();
        let body: String = self.rows.iter().map(line).collect();
        format!("{}|{rule}\n{body}", line(&self.head))
    }
}

/// Three decimals below 10, two from 10 on.
pub fn digits(value: f64) -> String {
    if value < 10.0 { format!("{value:.3}") } else { format!("{value:.2}") }
}

/// A ratio as the change in percent, with its interval.
pub fn percent(&Interval { low, mean, high }: &Interval) -> String {
    let [low, mean, high] = [low, mean, high].map(|ratio| 100.0 * (ratio - 1.0));
    format!("{mean:+.1} [{low:+.1}, {high:+.1}]")
}

/// ADE / FDE in three or four digits.
pub fn pair(errors: Errors) -> String {
    format!("{} / {}", digits(errors.ade_m), digits(errors.fde_m))
}

/// The ratio of the means of two quantities, with an interval that resamples clusters. Each item has the number of
/// its cluster.
pub(crate) fn ratio_of_clusters(items: impl Iterator<Item = (u64, [f64; 2])>) -> Option<Interval> {
    let mut clusters: BTreeMap<u64, PairedErrors> = BTreeMap::new();
    items.for_each(|(cluster, [ours, theirs])| clusters.entry(cluster).or_default().add(ours, theirs));
    paired_bootstrap_ratio(&clusters.into_values().collect::<Vec<_>>(), RESAMPLES, SEED)
}

/// A figure with its interval; `-` if there is none.
pub(crate) fn text_of_interval(figure: Option<Interval>, decimals: usize) -> String {
    figure.map_or("-".to_owned(), |Interval { mean, low, high }| {
        format!("{mean:.decimals$} ({low:.decimals$}–{high:.decimals$})")
    })
}
