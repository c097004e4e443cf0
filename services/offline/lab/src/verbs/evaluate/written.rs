//! The reports of all evaluations in one form.

use evaluator::Report;
use evaluator::driving::{GapReport, NoiseReport, SyntheticReport};
use evaluator::tracking::{KittiReport, TrackingReport};

use super::{NETWORK, SYNTHETIC};

/// A single report unchanged, several reports by name.
pub(super) fn json(written: &[Written]) -> serde_json::Value {
    match written {
        [one] => one.json.clone(),
        several => several.iter().map(|part| (part.name.to_owned(), part.json.clone())).collect(),
    }
}

/// A report in all its forms.
pub(super) struct Written {
    /// Name among several reports.
    pub name: &'static str,
    /// Its mark in a Markdown file.
    pub mark: String,
    /// The text that is printed without `--all`, if it is not the Markdown.
    pub text: Option<String>,
    pub markdown: String,
    pub summary: String,
    pub csv: String,
    pub json: serde_json::Value,
}

impl Written {
    pub fn new(
        name: &'static str,
        mark: impl Into<String>,
        [markdown, summary, csv]: [String; 3],
        json: serde_json::Value,
    ) -> Self {
        Self { name, mark: mark.into(), text: None, markdown, summary, csv, json }
    }

    pub fn of_forecasts(report: &Report, set: &str) -> Self {
        report.warnings.iter().for_each(|line| tracing::warn!("{line}"));
        report.left_out.iter().for_each(|line| tracing::warn!("left out: {line}"));
        report.failed.iter().for_each(|line| tracing::warn!("failed: {line}"));
        let mark = format!("evaluate {set}");
        let texts = [report.markdown(), report.summary(), report.csv()];
        Self { text: Some(report.text()), ..Self::new("forecasts", mark, texts, report.json()) }
    }

    pub fn of_motion(report: &TrackingReport) -> Self {
        let texts = [report.markdown(), report.summary(), report.csv()];
        Self::new("interaction", "evaluate tracking --parts interaction", texts, report.json())
    }

    pub fn of_noise(report: &NoiseReport) -> Self {
        let texts = [report.markdown(), report.markdown(), report.csv()];
        Self::new("recorded", "evaluate noise", texts, report.json())
    }

    pub fn of_network(report: &NoiseReport) -> Self {
        let texts = [report.markdown(), report.markdown(), report.csv()];
        Self::new(NETWORK, "evaluate noise --parts network", texts, report.json())
    }

    pub fn of_synthetic(report: &SyntheticReport) -> Self {
        let texts = [report.markdown(), report.markdown(), report.csv()];
        Self::new(SYNTHETIC, "evaluate noise --parts synthetic", texts, report.json())
    }

    pub fn of_gaps(report: &GapReport) -> Self {
        let texts = [report.markdown(), report.markdown(), report.csv()];
        Self::new("driving", "evaluate tracking --parts driving", texts, report.json())
    }

    pub fn of_trackers(report: &KittiReport) -> Self {
        let texts = [report.markdown(), report.summary(), report.csv()];
        Self::new("kitti", "evaluate tracking --parts kitti", texts, report.json())
    }
}
