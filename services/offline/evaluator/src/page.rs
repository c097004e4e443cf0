//! A report in all its forms.

use serde_json::{Value, json};

use crate::table::{COLUMNS, Table};

/// A report as text for people and for machines.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// Name among several reports.
    pub name: &'static str,
    /// Its mark in a Markdown file.
    pub mark: String,
    /// What is printed unless all tables are asked for; `None` if it is the Markdown.
    pub text: Option<String>,
    /// All tables as Markdown that is also readable in a terminal.
    pub markdown: String,
    /// The main tables, with headings of the second level.
    pub summary: String,
    /// The titles of the columns, then one line per figure.
    pub csv: String,
    /// All figures.
    pub json: Value,
}

impl Page {
    /// A report with the figures of these tables. The summary contains all tables.
    pub(crate) fn of(name: &'static str, mark: impl Into<String>, tables: &[Table]) -> Self {
        let markdown = sections(tables, "##", "");
        let csv = COLUMNS.to_owned() + &tables.iter().map(Table::csv).collect::<String>();
        let json = json!({ "tables": tables.iter().map(Table::json).collect::<Vec<_>>() });
        Self { name, mark: mark.into(), text: None, summary: markdown.clone(), markdown, csv, json }
    }

    /// The tables under a title, with text after them. The summary has the `main` tables.
    pub(crate) fn titled(self, title: &str, tables: &[Table], main: &[Table], closing: &str) -> Self {
        let [markdown, summary] = [("#", tables), ("##", main)].map(|(heading, tables)| {
            format!("{heading} {title}\n\n{}\n{closing}\n", sections(tables, &format!("{heading}#"), ""))
        });
        Self { markdown, summary, ..self }
    }

    /// Adds a fact to the JSON.
    pub(crate) fn with(mut self, key: &str, fact: impl serde::Serialize) -> Self {
        self.json[key] = json!(fact);
        self
    }
}

/// Tables as Markdown, each under its heading. `made` describes the origin of all figures.
pub(crate) fn sections<'a>(tables: impl IntoIterator<Item = &'a Table>, heading: &str, made: &str) -> String {
    tables.into_iter().map(|table| table.section(heading, made)).collect::<Vec<_>>().join("\n")
}
