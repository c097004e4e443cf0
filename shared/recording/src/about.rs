use std::collections::BTreeMap;
use std::path::Path;

use run::Run;
use serde::{Deserialize, Serialize};
use wire::SCHEMA;

/// Name of the file in a run's folder from which tools take what a recording says about its run.
pub const ABOUT: &str = "about.json";

/// What a recording says about its run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// Version of the wire.
    pub schema: u32,
    /// Name and version of the program.
    pub program: String,
    /// Text of pipeline.toml.
    pub pipeline: String,
    /// SHA-256 of the weights.
    pub weights_sha256: String,
    /// Instruction set of the kernels.
    pub kernels: String,
    /// Name of what the source plays.
    pub scene: String,
    /// The run's record: seed, options of the stages, lockstep, paths.
    pub run: Run,
    /// Topics that were asked for.
    #[serde(default)]
    pub topics: Vec<String>,
    /// Of the elements of these topics only so many leading bytes are recorded.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub element_bytes: BTreeMap<String, usize>,
    /// Whether the file has what the stages were given before its first message, from the run's begin on.
    #[serde(default)]
    pub before: bool,
    /// The Unix time less `CLOCK_MONOTONIC` when the recording began: the file's times are Unix times.
    #[serde(default)]
    pub clock_offset_ns: i64,
}

impl Default for About {
    fn default() -> Self {
        Self {
            schema: SCHEMA,
            program: String::new(),
            pipeline: String::new(),
            weights_sha256: String::new(),
            kernels: String::new(),
            scene: String::new(),
            run: Run::default(),
            topics: Vec::new(),
            element_bytes: BTreeMap::new(),
            before: false,
            clock_offset_ns: 0,
        }
    }
}

impl About {
    /// Reads what the launcher has written into a run's folder.
    ///
    /// # Errors
    /// If the file can't be read or is not of this version.
    pub fn of_run(root: &Path) -> std::io::Result<Self> {
        Ok(serde_json::from_slice(&std::fs::read(root.join(ABOUT))?)?)
    }

    /// Writes it into a run's folder.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn write(&self, root: &Path) -> std::io::Result<()> {
        std::fs::write(root.join(ABOUT), serde_json::to_vec(self)?)
    }

    /// The pairs of names and values that any reader of MCAP shows; `about` holds all of it as JSON.
    pub(crate) fn pairs(&self) -> Vec<(&'static str, String)> {
        vec![
            // Nothing here has keys that are no strings or numbers that JSON lacks.
            ("about", serde_json::to_string(self).unwrap_or_default()),
            ("interval_ns", self.run.interval_ns.to_string()),
            ("kernels", self.kernels.clone()),
            ("lockstep", self.run.lockstep.to_string()),
            ("pipeline.toml", self.pipeline.clone()),
            ("program", self.program.clone()),
            ("run_id", format!("{:016x}", self.run.id)),
            ("scene", self.scene.clone()),
            ("schema", self.schema.to_string()),
            ("seed", self.run.seed.to_string()),
            ("topics", self.topics.join(",")),
            ("weights_sha256", self.weights_sha256.clone()),
        ]
    }
}
