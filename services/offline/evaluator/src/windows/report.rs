//! Reports: tables for people, and one line per figure for machines.

use std::collections::{BTreeMap, BTreeSet};

use metrics::Interval;
use serde::Serialize;

use super::{COMPARED, DoubtCount, Group, Measure, Method, tables};
use crate::forecaster::{Crowding, Provenance};
use crate::page::{Page, sections};
use crate::table::Table;

/// One number of a report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// The part of the data.
    pub part: String,
    /// The subset of its agents.
    pub subset: &'static str,
    /// The quantity, with its unit.
    pub quantity: String,
    /// The method that made the forecasts.
    pub method: &'static str,
    /// How forecasts are compared with the truth; empty if the quantity needs no measure.
    pub measure: &'static str,
    /// Time ahead up to which the figure counts, s.
    pub horizon_s: f64,
    /// The number.
    pub value: f64,
    /// The 95 % interval, if the figure has one.
    pub interval: Option<[f64; 2]>,
    /// Number of agents.
    pub agents: u64,
}

/// The results of an evaluation.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// What was evaluated.
    pub title: String,
    /// The weights that made the forecasts.
    pub provenance: Vec<Provenance>,
    /// Probable defects of the recordings, one line each.
    pub warnings: Vec<String>,
    /// What the tables leave out and why, one line each.
    pub left_out: Vec<String>,
    /// Recordings that could not be evaluated, one line each.
    pub failed: Vec<String>,
    /// How often the audit of the input doubts recordings, by the kind of doubt.
    pub doubts: BTreeMap<String, DoubtCount>,
    /// The published forecasts and constant velocity. Only the protocol for recordings has this table.
    published: Option<Table>,
    /// Tables for people.
    tables: Vec<Table>,
    /// Figures for machines.
    pub figures: Vec<Figure>,
}

impl Report {
    pub(crate) fn new(title: &str) -> Self {
        Self { title: title.to_owned(), ..Self::default() }
    }

    pub(crate) fn add_table(&mut self, table: Table) {
        self.tables.push(table);
    }

    /// Adds one line about a part's windows that do not fit a payload, unless the report has it.
    fn add_crowding(&mut self, group: &Group) {
        let Crowding { window_count, agents_len, edges_len } = group.total.crowding;
        let mark = format!("{}: of ", group.part);
        if window_count > 0 && !self.left_out.iter().any(|line| line.starts_with(&mark)) {
            self.left_out.push(format!(
                "{mark}{window_count} windows, {agents_len} agents and {edges_len} edges of the farthest neighbours, for which \
                 payloads have no room"
            ));
        }
    }

    /// Adds every figure of a group, and a line on its windows that do not fit a payload.
    pub(crate) fn add_figures(&mut self, group: &Group, horizons_s: &[f64]) {
        self.add_crowding(group);
        for (horizon, &horizon_s) in horizons_s.iter().enumerate() {
            let figure =
                |quantity: String, method: Method, measure: &'static str, value: f64, agents: u64| Figure {
                    part: group.part.clone(),
                    subset: group.subset.name(),
                    quantity,
                    method: method.name(),
                    measure,
                    horizon_s,
                    value,
                    interval: None,
                    agents,
                };
            for (method, measure) in all_pairs() {
                let Some(errors) = group.total.errors(method, measure, horizon) else { continue };
                let agents = group.total.len(method, measure);
                for (name, value) in [("ADE", errors.ade_m), ("FDE", errors.fde_m)] {
                    let quantity = format!("{name}, {}", group.unit);
                    self.figures.push(figure(quantity, method, measure.name(), value, agents));
                }
            }
            for rate in tables::rates(&group.total, horizon) {
                let agents = group.total.agents_len;
                let of_rate =
                    rate.value.map(|value| figure(rate.name.to_owned(), rate.method, "", value, agents));
                self.figures.extend(of_rate);
            }
            if horizon + 1 < horizons_s.len() {
                continue;
            }
            for (place, (measure, method)) in COMPARED.into_iter().enumerate() {
                let Some(pair) = group.compare(place) else { continue };
                for (name, contrast) in ["ADE", "FDE"].iter().zip(pair) {
                    let Interval { low, mean, high } = contrast.difference;
                    let quantity = format!("ours less theirs, {name}, {}", group.unit);
                    let agents = group.total.len(method, measure);
                    let difference = figure(quantity, method, measure.name(), mean, agents);
                    self.figures.push(Figure { interval: Some([low, high]), ..difference });
                }
            }
        }
    }

    /// Adds our rows of the main tables by other trainings of the same recipes, for example with other seeds.
    /// The results are listed training by training. [`Report::csv`] and [`Report::json`] do not change.
    pub fn add_beside(&mut self, others: &[Self]) {
        if others.is_empty() {
            return;
        }
        let name = self.training();
        let names: Vec<String> = others.iter().map(Self::training).collect();
        let compared = self.tables.iter().enumerate().filter_map(|(place, table)| {
            let others = others
                .iter()
                .zip(&names)
                .filter_map(|(other, name)| Some((&name[..], other.tables.get(place)?)));
            table.by_training(&name, &others.collect::<Vec<_>>())
        });
        let compared: Vec<Table> = compared.collect();
        self.tables.extend(compared);
        self.provenance.extend(others.iter().flat_map(|other| other.provenance.iter().cloned()));
    }

    /// The seed that all weights share, or the first weights' fingerprint.
    fn training(&self) -> String {
        let seeds: BTreeSet<Option<u64>> = self.provenance.iter().map(|provenance| provenance.seed).collect();
        match seeds.first().copied().flatten().filter(|_| seeds.len() == 1) {
            Some(seed) => format!("seed {seed}"),
            None => self.provenance.first().map_or_else(String::new, |first| first.sha256[..8].to_owned()),
        }
    }

    pub(crate) fn set_published(&mut self, table: Table) {
        self.published = Some(table);
    }

    /// The published forecasts compared with constant velocity, what is left out or failed, and doubts. `None`
    /// for data sets.
    pub fn brief(&self) -> Option<String> {
        let table = self.published.as_ref()?;
        let mut text = table.section("##", "");
        for (what, lines) in self.lists() {
            lines.iter().for_each(|line| text += &format!("\n{what}: {line}\n"));
        }
        Some(text)
    }

    /// What `evaluate` prints: the main table of recordings, all tables of data sets.
    pub fn text(&self) -> String {
        let brief = self.brief();
        brief.map_or_else(
            || self.markdown(),
            |brief| format!("{brief}\n`--all` prints all methods, horizons and intervals.\n"),
        )
    }

    /// The report as Markdown that is also readable in a terminal.
    pub fn markdown(&self) -> String {
        self.written(&self.tables, "#")
    }

    /// The main tables with their main rows as Markdown, one heading level lower.
    pub fn summary(&self) -> String {
        self.written(&self.tables.iter().filter_map(Table::summary).collect::<Vec<_>>(), "##")
    }

    /// The title as a heading, followed by the tables.
    fn written(&self, tables: &[Table], heading: &str) -> String {
        let mut text = format!("{heading} {}\n\n", self.title);
        let made = self.made();
        text += &sections(tables, &format!("{heading}#"), &made);
        text += "\n";
        for (what, lines) in self.lists().into_iter().filter(|(_, lines)| !lines.is_empty()) {
            text += &format!("{what}:\n\n");
            lines.iter().for_each(|line| text += &format!("* {line}\n"));
            text += "\n";
        }
        text += "Weights and maps of the tables above:\n\n";
        for provenance in &self.provenance {
            text += &format!("* {}\n", provenance.line());
        }
        text
    }

    /// The report in all its forms. `set` is its mark in a Markdown file.
    pub fn page(&self, set: &str) -> Page {
        Page {
            name: "forecasts",
            mark: format!("evaluate {set}"),
            text: Some(self.text()),
            markdown: self.markdown(),
            summary: self.summary(),
            csv: self.csv(),
            json: self.json(),
        }
    }

    /// Recordings that the tables leave out, and doubts about the others.
    fn lists(&self) -> [(&'static str, Vec<String>); 3] {
        let doubts = self.doubts.iter().map(|(kind, DoubtCount { recordings, rows, of })| {
            format!("{}: {recordings} recordings, {rows} of {of} rows", kind.replace('_', " "))
        });
        [("Left out", self.left_out.clone()), ("Failed", self.failed.clone()), ("Doubt", doubts.collect())]
    }

    /// How the 20 forecasts of each agent were made; a line for every table.
    fn made(&self) -> String {
        let mut draws: Vec<&str> = self.provenance.iter().map(|provenance| &provenance.draws[..]).collect();
        draws.dedup();
        let mut weights: Vec<&str> =
            self.provenance.iter().map(|p| p.sha256.get(..8).unwrap_or_default()).collect();
        weights.dedup();
        format!(
            "The 20 modes: ours {}; B* and anchors all of their 20 modes; CVM-S 20 of 20 draws. Weights {}.",
            draws.join(" or "),
            weights.join(", "),
        )
    }

    /// One line per figure, with the fingerprint of its weights.
    pub fn csv(&self) -> String {
        let mut text =
            "part,subset,method,measure,horizon_s,quantity,value,low,high,agents,weights_sha256\n".to_owned();
        for figure in &self.figures {
            let Figure { part, subset, quantity, method, measure, horizon_s, value, interval, agents } =
                figure;
            let interval =
                interval.map_or_else(|| ",".to_owned(), |[low, high]| format!("{low:.6},{high:.6}"));
            let sha256 = self.provenance_of(part).map_or("", |provenance| &provenance.sha256);
            text += &format!(
                "\"{part}\",{subset},\"{method}\",\"{measure}\",{horizon_s},\"{quantity}\",{value:.6},{interval},{agents},{sha256}\n"
            );
        }
        text
    }

    /// The whole report as JSON.
    pub fn json(&self) -> serde_json::Value {
        let Self { title, provenance, left_out, failed, doubts, figures, .. } = self;
        serde_json::json!({
            "title": title,
            "provenance": provenance,
            "left_out": left_out,
            "failed": failed,
            "doubts": doubts,
            "figures": figures,
        })
    }

    /// The provenance of a part: the one with the longest name that the part's name begins with.
    fn provenance_of(&self, part: &str) -> Option<&Provenance> {
        let of = |provenance: &&Provenance| part.starts_with(&provenance.part);
        self.provenance.iter().filter(of).max_by_key(|provenance| provenance.part.len())
    }
}

/// Every method with every measure.
fn all_pairs() -> impl Iterator<Item = (Method, Measure)> {
    Method::ALL.into_iter().flat_map(|method| Measure::ALL.map(|measure| (method, measure)))
}
