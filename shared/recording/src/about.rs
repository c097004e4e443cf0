use std::collections::BTreeMap;
use std::path::Path;

use run::Run;
use serde::{Deserialize, Serialize};
use wire::SCHEMA;

/// Name of the file in a run's folder that holds the [`About`] for recordings.
pub const ABOUT: &str = "about.json";

/// The description of a run in its recording.
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
    /// Name of the scene that the source plays.
    pub scene: String,
    /// The run's record: seed, options of the stages, lockstep, paths.
    pub run: Run,
    /// The requested topics.
    #[serde(default)]
    pub topics: Vec<String>,
    /// Number of recorded leading bytes per element, for topics whose elements are recorded in part.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub element_bytes: BTreeMap<String, usize>,
    /// Whether the file contains the stages' inputs from the start of the run up to the file's first message.
    #[serde(default)]
    pub before: bool,
    /// Unix time minus `CLOCK_MONOTONIC` at the start of the recording: the file's times are Unix times.
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
    /// Reads the file that the launcher has written into a run's folder.
    ///
    /// # Errors
    /// If the file can't be read or is not of this version.
    pub fn of_run(root: &Path) -> std::io::Result<Self> {
        Ok(serde_json::from_slice(&std::fs::read(root.join(ABOUT))?)?)
    }

    /// Writes the file into a run's folder.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn write(&self, root: &Path) -> std::io::Result<()> {
        std::fs::write(root.join(ABOUT), serde_json::to_vec(self)?)
    }

    /// The pairs of names and values that every MCAP reader shows; `about` holds all fields as JSON.
    pub(crate) fn pairs(&self) -> Vec<(&'static str, String)> {
        vec![
            // Every key is a string, and JSON can represent every number.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The `about` of the first recordings, without any field that was added later.
    const FIRST: &str = r#"{"schema": 2, "program": "stgdat 0.1.0", "pipeline": "", "weights_sha256": "ae48",
        "kernels": "AVX-512", "scene": "generated intersection, 32 agents, seed 1",
        "run": {"id": 7, "prefix": "stgdat_7_", "root": "/tmp/stgdat_7", "interval_ns": 80000000, "lockstep": false,
            "seed": 1, "protected": ["detections"], "shed": true, "weights": null,
            "stages": [{"stage": 7, "budget_ms": 8.0, "built_in": true, "options": "deadline_ms = 72\n"}],
            "spares": []}}"#;

    #[test]
    fn recordings_of_earlier_versions_lack_only_fields_that_have_defaults() {
        let about: About = serde_json::from_str(FIRST).unwrap();
        assert_eq!((about.run.id, about.run.stages[0].stage), (7, 7));
        assert!(about.run.stages[0].places.is_empty() && about.run.topics.is_empty() && !about.before);
    }
}
