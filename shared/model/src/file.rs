use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::{ConfigError, ModelConfig};

/// Name of the file in a run's directory that contains the model's configuration as JSON.
pub const FILE: &str = "model.json";

/// Why the model file of a run can't be read or written.
#[derive(Debug, Error)]
pub enum ModelFileError {
    /// The file can't be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file does not contain a model's configuration.
    #[error("{}: {source}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The parser's error.
        source: serde_json::Error,
    },
    /// A value of the configuration is invalid.
    #[error("{}: {source}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The invalid value.
        source: ConfigError,
    },
}

impl ModelConfig {
    /// The model of the run in the directory `root`.
    ///
    /// # Errors
    /// [`ModelFileError`] if the file is missing or can't be used.
    pub fn of_run(root: &Path) -> Result<Self, ModelFileError> {
        let path = root.join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) => return Err(ModelFileError::File { path, source }),
        };
        let config: Self = match serde_json::from_str(&text) {
            Ok(config) => config,
            Err(source) => return Err(ModelFileError::Json { path, source }),
        };
        match config.check() {
            Ok(()) => Ok(config),
            Err(source) => Err(ModelFileError::Value { path, source }),
        }
    }

    /// Writes the model of the run in the directory `root`, for [`ModelConfig::of_run`].
    ///
    /// # Errors
    /// [`ModelFileError`] if the file can't be written.
    pub fn write(&self, root: &Path) -> Result<(), ModelFileError> {
        let path = root.join(FILE);
        let text = match serde_json::to_string_pretty(self) {
            Ok(text) => text,
            Err(source) => return Err(ModelFileError::Json { path, source }),
        };
        std::fs::write(&path, text).map_err(|source| ModelFileError::File { path, source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: &str = r#"{
        "width": 16, "stem": "compact", "patch_size": 16, "patch_cell_m": 2.0, "edge_radius_m": 20.0, "history_len": 8,
        "horizon_len": 12, "dt_s": 0.4, "rounds": 2, "topological_heads": 4, "temporal_heads": 4,
        "temporal": "value_matrix", "edge_in_message": true, "distance_scale": true, "position_scale": 0.1,
        "velocity_scale": 0.1, "leaky_slope": 0.2
    }"#;

    #[test]
    fn a_run_has_the_model_that_was_written() {
        let root = tempfile::tempdir().unwrap();
        let config: ModelConfig = serde_json::from_str(PAPER).unwrap();
        config.write(root.path()).unwrap();
        assert_eq!(ModelConfig::of_run(root.path()).unwrap(), config);
    }

    #[test]
    fn a_model_that_cannot_be_used_is_refused_with_its_path() {
        let root = tempfile::tempdir().unwrap();
        let refused = || ModelConfig::of_run(root.path()).unwrap_err().to_string();
        assert!(refused().contains(FILE), "{}", refused());
        for (text, expected) in [
            ("{", "EOF"),
            (&PAPER.replace("width", "wide"), "unknown field `wide`"),
            (&PAPER.replace("\"rounds\": 2", "\"rounds\": 9"), "rounds = 9"),
        ] {
            std::fs::write(root.path().join(FILE), text).unwrap();
            assert!(refused().contains(expected) && refused().contains(FILE), "{}", refused());
        }
    }
}
