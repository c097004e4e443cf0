//! Tables: their figures as Markdown, CSV and JSON, and how a figure is written.

use std::collections::BTreeMap;

use metrics::{Errors, Interval, PairedErrors, paired_bootstrap_ratio};
use serde_json::{Map, Value, json};

/// Resamples per interval.
pub const RESAMPLES: usize = 1000;
/// Seed of the resamples.
pub(crate) const SEED: u64 = 1;
/// The first line of tables as CSV.
pub(crate) const COLUMNS: &str = "table,row,column,value,low,high\n";

/// A cell of a table: its text, and the numbers behind the text.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    pub(crate) text: String,
    /// Each number with its name. A single number has an empty name.
    numbers: Vec<(&'static str, f64)>,
    /// The ends of the single number's 95 % interval.
    interval: Option<[f64; 2]>,
}

/// A row of a table.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) names: Vec<String>,
    /// By column; `None` if the figure is unknown.
    pub(crate) entries: Vec<Option<Entry>>,
}

/// A table of figures.
#[derive(Clone, Debug)]
pub struct Table {
    pub(crate) title: String,
    pub(crate) note: String,
    /// Titles of the columns of names.
    pub(crate) names: Vec<String>,
    /// Titles of the columns of figures.
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<Row>,
    /// A sentence after the rows.
    pub(crate) closing: String,
    /// Whether a summary contains the table.
    pub(crate) is_main: bool,
    /// Whether a summary contains all rows.
    pub(crate) is_brief: bool,
}

impl Entry {
    /// Numbers with their names, and how they are written.
    pub(crate) fn new(
        text: impl Into<String>,
        numbers: impl IntoIterator<Item = (&'static str, f64)>,
    ) -> Self {
        Self { text: text.into(), numbers: numbers.into_iter().collect(), interval: None }
    }

    pub(crate) fn number(value: f64, decimals: usize) -> Self {
        Self::new(format!("{value:.decimals$}"), [("", value)])
    }

    pub(crate) fn count(len: usize) -> Self {
        Self::new(len.to_string(), [("", len as f64)])
    }

    /// A number in three or four digits.
    pub(crate) fn digits(value: f64) -> Self {
        Self::new(digits(value), [("", value)])
    }

    /// A number and its interval.
    pub(crate) fn interval(Interval { low, mean, high }: Interval, decimals: usize) -> Self {
        let text = format!("{mean:.decimals$} ({low:.decimals$}–{high:.decimals$})");
        Self { interval: Some([low, high]), ..Self::new(text, [("", mean)]) }
    }

    /// A difference and its interval, with signs.
    pub(crate) fn difference(Interval { low, mean, high }: Interval, decimals: usize) -> Self {
        let text = format!("{mean:+.decimals$} [{low:+.decimals$}, {high:+.decimals$}]");
        Self { interval: Some([low, high]), ..Self::new(text, [("", mean)]) }
    }

    /// A ratio as the change in percent, with its interval.
    pub(crate) fn percent(Interval { low, mean, high }: Interval) -> Self {
        let [low, mean, high] = [low, mean, high].map(|ratio| 100.0 * (ratio - 1.0));
        Self::difference(Interval { low, mean, high }, 1)
    }

    /// The number; an object if there are several or an interval; the text if there is none.
    fn json(&self) -> Value {
        match (&self.numbers[..], self.interval) {
            ([], _) => json!(self.text),
            ([(_, value)], Some([low, high])) => json!({ "value": value, "low": low, "high": high }),
            ([(_, value)], None) => json!(value),
            (several, _) => several.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect(),
        }
    }
}

impl From<String> for Entry {
    fn from(text: String) -> Self {
        Self::new(text, [])
    }
}

impl Table {
    /// An empty table. `names` are the titles of its first columns.
    pub fn new(
        title: &str,
        note: &str,
        names: &[&str],
        columns: impl IntoIterator<Item = impl Into<String>>,
    ) -> Self {
        Self {
            title: title.to_owned(),
            note: note.to_owned(),
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            columns: columns.into_iter().map(Into::into).collect(),
            rows: Vec::new(),
            closing: String::new(),
            is_main: false,
            is_brief: false,
        }
    }

    /// Marks the table for summaries.
    pub fn main(self) -> Self {
        Self { is_main: true, ..self }
    }

    /// Adds a row: its names, and its figures.
    pub fn push(
        &mut self,
        names: &[impl AsRef<str>],
        figures: impl IntoIterator<Item = impl Into<Option<Entry>>>,
    ) {
        let names = names.iter().map(|name| name.as_ref().to_owned()).collect();
        self.rows.push(Row { names, entries: figures.into_iter().map(Into::into).collect() });
    }

    /// Adds a row as [`Table::push`] does, if at least one figure is known.
    pub(crate) fn push_known(&mut self, names: &[&str], figures: impl IntoIterator<Item = Option<Entry>>) {
        let figures: Vec<Option<Entry>> = figures.into_iter().collect();
        if figures.iter().any(Option::is_some) {
            self.push(names, figures);
        }
    }

    /// The table as Markdown under a heading. `made` describes the origin of its figures.
    pub(crate) fn section(&self, heading: &str, made: &str) -> String {
        let parts = [&self.note, made].into_iter().filter(|part| !part.is_empty());
        let note = parts.collect::<Vec<_>>().join(" ");
        let closing = if self.closing.is_empty() { String::new() } else { format!("\n{}\n", self.closing) };
        let note = if note.is_empty() { note } else { note + "\n\n" };
        format!("{heading} {}\n\n{note}{}{closing}", self.title, self.grid())
    }

    /// Only the head and the rows.
    pub fn grid(&self) -> String {
        let shown = |row: &Row| {
            let entries = row.entries.iter().map(|entry| entry.as_ref().map_or("-", |entry| &entry.text));
            row.names.iter().map(String::as_str).chain(entries).map(str::to_owned).collect::<Vec<_>>()
        };
        let head = [&self.names[..], &self.columns].concat();
        let lines: Vec<Vec<String>> = std::iter::once(head).chain(self.rows.iter().map(shown)).collect();
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..lines[0].len()).map(width).collect();
        let line = |line: &Vec<String>| {
            let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                // Names are aligned left, figures right.
                if column < self.names.len() {
                    format!(" {cell:<width$} |")
                } else {
                    format!(" {cell:>width$} |")
                }
            });
            format!("|{}\n", cells.collect::<String>())
        };
        let rule: String = widths.iter().map(|width| format!("{}|", "-".repeat(width + 2))).collect();
        let body: String = lines[1..].iter().map(line).collect();
        format!("{}|{rule}\n{body}", line(&lines[0]))
    }

    /// One line per known number, in the order of [`COLUMNS`].
    pub(crate) fn csv(&self) -> String {
        let mut text = String::new();
        for Row { names, entries } in &self.rows {
            for (column, entry) in self.columns.iter().zip(entries) {
                let Some(Entry { numbers, interval, .. }) = entry else { continue };
                let ends =
                    interval.map_or_else(|| ",".to_owned(), |[low, high]| format!("{low:.6},{high:.6}"));
                for (name, value) in numbers.iter().filter(|(_, value)| value.is_finite()) {
                    let is_single = name.is_empty() || name == column;
                    let column = if is_single { column.clone() } else { format!("{column}, {name}") };
                    let [title, row, column] = [&self.title, &names.join(", "), &column].map(quoted);
                    text += &format!("{title},{row},{column},{value:.6},{ends}\n");
                }
            }
        }
        text
    }

    /// A list of rows with the columns' titles as keys.
    pub(crate) fn json(&self) -> Value {
        let row = |row: &Row| {
            let names = self.names.iter().cloned().zip(row.names.iter().map(|name| json!(name)));
            let entries = row.entries.iter().map(|entry| entry.as_ref().map_or(Value::Null, Entry::json));
            names.chain(self.columns.iter().cloned().zip(entries)).collect::<Map<_, _>>()
        };
        json!({ "title": self.title, "rows": self.rows.iter().map(row).collect::<Vec<_>>() })
    }
}

/// Three decimals below 10, two from 10 on.
pub fn digits(value: f64) -> String {
    if value < 10.0 { format!("{value:.3}") } else { format!("{value:.2}") }
}

/// ADE / FDE in three or four digits.
pub fn pair(Errors { ade_m, fde_m }: Errors) -> Entry {
    Entry::new(format!("{} / {}", digits(ade_m), digits(fde_m)), [("ADE", ade_m), ("FDE", fde_m)])
}

/// The ratio of the means of two quantities, with an interval that resamples clusters. Each item has the number of
/// its cluster.
pub(crate) fn ratio_of_clusters(items: impl Iterator<Item = (u64, [f64; 2])>) -> Option<Interval> {
    let mut clusters: BTreeMap<u64, PairedErrors> = BTreeMap::new();
    items.for_each(|(cluster, [ours, theirs])| clusters.entry(cluster).or_default().add(ours, theirs));
    paired_bootstrap_ratio(&clusters.into_values().collect::<Vec<_>>(), RESAMPLES, SEED)
}

/// A text cell of CSV. Names of files may contain quotes [RFC 4180].
fn quoted(text: impl AsRef<str>) -> String {
    format!("\"{}\"", text.as_ref().replace('"', "\"\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_in_a_name_stay_in_its_cell() {
        let mut table = Table::new("Errors", "", &["source"], ["a"]);
        table.push(&["the \"old\" road"], [Entry::count(1)]);
        assert_eq!(table.csv(), "\"Errors\",\"the \"\"old\"\" road\",\"a\",1.000000,,\n");
    }

    #[test]
    fn a_number_is_the_same_in_all_forms() {
        let mut table = Table::new("Errors", "In m.", &["type", "noise"], ["a", "b", "ratio", "forecasts"]);
        let ratio = Interval { low: 0.9, mean: 1.0, high: 1.1 };
        let pair = pair(Errors { ade_m: 0.25, fde_m: 0.5 });
        let entries = [Some(pair), None, Some(Entry::interval(ratio, 2)), Some(Entry::count(12))];
        table.push(&["vehicle", "0.1"], entries);
        let markdown = table.section("##", "");
        assert!(markdown.starts_with("## Errors\n\nIn m.\n\n| type "), "{markdown}");
        let row = "| vehicle | 0.1   | 0.250 / 0.500 | - | 1.00 (0.90–1.10) |        12 |";
        assert!(markdown.contains(row), "{markdown}");
        let start = "\"Errors\",\"vehicle, 0.1\",";
        let lines =
            ["\"a, ADE\",0.250000,,", "\"a, FDE\",0.500000,,", "\"ratio\",1.000000,0.900000,1.100000"];
        let expected: String = lines.iter().map(|line| format!("{start}{line}\n")).collect();
        assert_eq!(table.csv(), format!("{expected}{start}\"forecasts\",12.000000,,\n"));
        let row = &table.json()["rows"][0];
        assert_eq!(
            (&row["a"]["FDE"], &row["ratio"]["low"], &row["b"]),
            (&json!(0.5), &json!(0.9), &Value::Null)
        );
        assert_eq!((&row["type"], &row["forecasts"]), (&json!("vehicle"), &json!(12.0)));
    }
}
