//! A report in all its forms.

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
    /// One line per figure.
    pub csv: String,
    /// All figures.
    pub json: serde_json::Value,
}

impl Page {
    /// A report whose main tables are all of its tables.
    #[must_use]
    pub fn new(
        name: &'static str,
        mark: impl Into<String>,
        markdown: String,
        csv: String,
        json: serde_json::Value,
    ) -> Self {
        Self { name, mark: mark.into(), text: None, summary: markdown.clone(), markdown, csv, json }
    }
}
