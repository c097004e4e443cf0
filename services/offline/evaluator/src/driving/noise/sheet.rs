//! A table of numbers, as Markdown, CSV and JSON.

use crate::page::Page;
use crate::table::{Table, digits};
use serde_json::json;

/// The column of whole numbers.
pub(crate) const COUNTS: &str = "forecasts";

/// The first line of the tables of noise as CSV.
pub const COLUMNS: &str = "table,row,column,value\n";

/// A table whose cells are numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Sheet {
    pub(crate) title: &'static str,
    pub(crate) note: String,
    /// Titles of the columns of names.
    pub(crate) names: Vec<&'static str>,
    /// Titles of the columns of numbers.
    pub(crate) columns: Vec<&'static str>,
    pub(crate) rows: Vec<Row>,
}

/// A row: its names, and a number per column if it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Row {
    pub(crate) names: Vec<String>,
    pub(crate) values: Vec<Option<f64>>,
}

impl Sheet {
    /// The table under a heading of the second level.
    pub(crate) fn markdown(&self) -> String {
        let mut table = Table::new("", "", &self.names, self.columns.iter().copied());
        for row in &self.rows {
            let shown = |(column, value): (&&str, &Option<f64>)| match value {
                Some(count) if *column == COUNTS => Some(format!("{count:.0}")),
                value => value.map(digits),
            };
            let names: Vec<&str> = row.names.iter().map(String::as_str).collect();
            table.push(&names, self.columns.iter().zip(&row.values).map(shown));
        }
        format!("## {}\n\n{}\n\n{}", self.title, self.note, table.grid())
    }

    /// One line per number.
    pub(crate) fn csv(&self) -> String {
        let mut text = String::new();
        for row in &self.rows {
            for (column, value) in self.columns.iter().zip(&row.values) {
                let Some(value) = value else { continue };
                text += &format!("\"{}\",\"{}\",\"{column}\",{value:.6}\n", self.title, row.names.join(", "));
            }
        }
        text
    }

    /// A list of rows with the columns' titles as keys.
    pub(crate) fn json(&self) -> serde_json::Value {
        let row = |row: &Row| {
            let names = self.names.iter().zip(&row.names).map(|(key, name)| ((*key).to_owned(), json!(name)));
            let values =
                self.columns.iter().zip(&row.values).map(|(key, value)| ((*key).to_owned(), json!(value)));
            serde_json::Value::Object(names.chain(values).collect())
        };
        json!({ "title": self.title, "rows": self.rows.iter().map(row).collect::<Vec<_>>() })
    }
}

/// The report of one sheet, or of several.
pub(crate) fn page(name: &'static str, mark: &str, sheets: &[Sheet]) -> Page {
    let markdown: Vec<String> = sheets.iter().map(Sheet::markdown).collect();
    let json = match sheets {
        [one] => one.json(),
        several => several.iter().map(Sheet::json).collect(),
    };
    Page::new(name, mark, markdown.join("\n"), sheets.iter().map(Sheet::csv).collect(), json)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_the_same_in_all_forms() {
        let sheet = Sheet {
            title: "Errors",
            note: "In m.".to_owned(),
            names: vec!["type", "noise"],
            columns: vec!["a", "b", COUNTS],
            rows: vec![Row {
                names: vec!["vehicle".to_owned(), "0.1".to_owned()],
                values: vec![Some(0.25), None, Some(12.0)],
            }],
        };
        let markdown = sheet.markdown();
        assert!(markdown.starts_with("## Errors\n\nIn m.\n\n| type "), "{markdown}");
        assert!(markdown.contains("| vehicle | 0.1   | 0.250 | - |        12 |"), "{markdown}");
        let lines = "\"Errors\",\"vehicle, 0.1\",\"a\",0.250000\n\"Errors\",\"vehicle, 0.1\",\"forecasts\",12.000000\n";
        assert_eq!(sheet.csv(), lines);
        assert_eq!(sheet.json()["rows"][0]["a"], 0.25);
        assert!(sheet.json()["rows"][0]["b"].is_null());
    }
}
