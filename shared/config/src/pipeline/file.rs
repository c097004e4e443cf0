//! pipeline.toml as it is written; every value knows its place in the text.

use std::path::PathBuf;

use serde::Deserialize;
use toml::Spanned;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub weights: Option<PathBuf>,
    #[serde(rename = "stage", default)]
    pub stages: Vec<Spanned<StageTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StageTable {
    pub name: Spanned<String>,
    pub command: Option<Spanned<Vec<String>>>,
    #[serde(default)]
    pub reads: Vec<Spanned<String>>,
    #[serde(default)]
    pub writes: Vec<Spanned<String>>,
    pub budget_ms: Option<Spanned<f64>>,
    #[serde(default)]
    pub options: OptionsTable,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct OptionsTable {
    pub deadline_ms: Option<Spanned<f64>>,
    pub workers: Option<Spanned<usize>>,
    pub map: Option<Spanned<String>>,
    pub prior: Option<Spanned<String>>,
    pub association: Option<Spanned<String>>,
    pub view: Option<Spanned<String>>,
    pub recall: Option<Spanned<bool>>,
    pub memory: Option<Spanned<PathBuf>>,
    pub propagation: Option<Spanned<String>>,
    pub particles: Option<Spanned<usize>>,
}
