//! pipeline.toml as written. Every value has its span in the text.

use std::collections::BTreeMap;
use std::path::PathBuf;

use run::Declared;
use serde::Deserialize;
use toml::Spanned;

use supervisor::Restart;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub weights: Option<PathBuf>,
    pub origin: Option<Spanned<String>>,
    pub protect: Option<Vec<Spanned<String>>>,
    pub shed: Option<bool>,
    pub awake: Option<Spanned<bool>>,
    pub memory_mib: Option<Spanned<u64>>,
    pub realtime: Option<RealtimeTable>,
    #[serde(default)]
    pub readers: BTreeMap<Spanned<String>, Spanned<u64>>,
    #[serde(rename = "stage", default)]
    pub stages: Vec<Spanned<StageTable>>,
    #[serde(rename = "topic", default)]
    pub topics: Vec<Spanned<TopicTable>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RealtimeTable {
    pub profile: Option<Spanned<Profile>>,
    pub priority: Option<Spanned<u64>>,
    pub cpu: Option<Spanned<toml::Value>>,
    pub awake: Option<Spanned<bool>>,
    pub lock: Option<bool>,
}

/// A set of real-time settings under one name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Profile {
    /// A machine that serves the vehicle alone.
    Vehicle,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TopicTable {
    pub name: Spanned<String>,
    pub type_name: Spanned<String>,
    pub element_bytes: Spanned<u64>,
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
    #[serde(default)]
    pub topics: BTreeMap<Spanned<String>, Spanned<String>>,
    pub restart: Option<Restart>,
    pub backoff_ms: Option<Spanned<u64>>,
    pub restarts_max: Option<Spanned<u64>>,
    pub window_s: Option<Spanned<u64>>,
    pub start_limit_s: Option<Spanned<u64>>,
    pub hang_after_ms: Option<Spanned<u64>>,
    pub cpu: Option<Spanned<Vec<Spanned<u64>>>>,
    pub priority: Option<Spanned<u64>>,
    pub memory_mib: Option<Spanned<u64>>,
    pub spare: Option<Spanned<bool>>,
}

impl File {
    /// Gives the topics of its declaration to a stage for which the file lists none.
    pub fn add_topics_of(&mut self, declared: &[&dyn Declared]) {
        for table in self.stages.iter_mut().map(Spanned::get_mut) {
            let declares = |stage: &&&dyn Declared| stage.id().name() == table.name.get_ref();
            if let Some(stage) = declared.iter().find(declares)
                && table.reads.is_empty()
                && table.writes.is_empty()
            {
                let topics = |names: &[&str]| {
                    names.iter().map(|&name| Spanned::new(table.name.span(), name.to_owned())).collect()
                };
                (table.reads, table.writes) = (topics(stage.reads()), topics(stage.writes()));
            }
        }
    }
}

/// A stage's options. The stage's declaration checks them.
pub(super) type OptionsTable = BTreeMap<Spanned<String>, Spanned<toml::Value>>;
