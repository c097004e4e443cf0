//! The log that training writes: one JSON object per line, for training or for validation.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use metrics::Errors;
use serde::Deserialize;
use thiserror::Error;

/// Size of the longest accepted log, bytes.
const BYTES_MAX: u64 = 256 << 20;

/// The progress of training at a step: means over the last few steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct Progress {
    /// Steps done.
    pub step: u64,
    /// Time since training began.
    pub seconds: f64,
    /// Learning rate.
    pub rate: f64,
    /// The loss: the weighted sum of its terms.
    pub loss: f64,
    /// Distance of the best mode.
    pub trajectory: f64,
    /// Distance of the single best forecast.
    pub single: f64,
    /// Term of the modes' probabilities.
    pub probability: f64,
    /// Term of the forecast distribution's width.
    pub spread: f64,
}

/// The quality of the weights at a step.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Validation {
    /// Steps done.
    pub step: u64,
    /// The figure that selects the checkpoint; smaller is better.
    pub validation: f64,
    /// The errors on each data set.
    #[serde(default)]
    pub sets: Vec<SetErrors>,
}

/// Errors on the validation part of a data set.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct SetErrors {
    /// Name of the set.
    pub set: String,
    /// Error of the best mode.
    pub best_of_modes: Errors,
    /// Error of the single best forecast.
    pub single: Errors,
}

/// The entries of a log in order of steps, without entries of abandoned branches of the training.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainingLog {
    /// Training lines.
    pub progress: Vec<Progress>,
    /// Validation lines.
    pub validations: Vec<Validation>,
}

/// Why a log cannot be used.
#[derive(Debug, Error)]
pub enum LogError {
    /// The file can't be read.
    #[error("{path}: {source}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A line is not a valid log line.
    #[error("{path}, line {line}: {reason}", path = path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// The reason.
        reason: String,
    },
    /// The file is too long, or has no lines.
    #[error("{path}: {reason}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
}

/// The two kinds are distinguished by the fields that only validations have.
#[derive(Deserialize)]
#[serde(untagged)]
enum Entry {
    Validation(Validation),
    Progress(Progress),
}

impl TrainingLog {
    /// Reads a log.
    ///
    /// Training that resumes from a checkpoint goes back to the step of the checkpoint. Lines that the
    /// interrupted training wrote after this step are discarded. A last line without a line end was cut off
    /// by an interruption and is also discarded.
    ///
    /// # Errors
    /// [`LogError`] if the file cannot be read, is too long, has no lines or has an invalid line.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let unreadable = |source| LogError::Unreadable { path: path.to_owned(), source };
        let unusable = |reason| LogError::File { path: path.to_owned(), reason };
        let mut lines = BufReader::new(File::open(path).map_err(unreadable)?.take(BYTES_MAX + 1));
        let (mut log, mut bytes, mut number) = (Self::default(), 0, 0);
        let mut line = String::new();
        while lines.read_line(&mut line).map_err(unreadable)? > 0 {
            number += 1;
            bytes += line.len() as u64;
            if bytes > BYTES_MAX {
                return Err(unusable(format!("longer than {BYTES_MAX} bytes")));
            }
            let is_whole = line.ends_with('\n');
            match serde_json::from_str(&line) {
                Ok(entry) => log.add(entry),
                Err(_) if line.trim().is_empty() || !is_whole => (),
                Err(error) => {
                    let reason = reason(&line, &error);
                    return Err(LogError::Line { path: path.to_owned(), line: number, reason });
                }
            }
            line.clear();
        }
        if log.progress.is_empty() && log.validations.is_empty() {
            return Err(unusable("no line of training or validation".to_owned()));
        }
        Ok(log)
    }

    /// The validation of the chosen checkpoint: the first one with the best figure.
    pub fn best(&self) -> Option<&Validation> {
        let finite = self.validations.iter().filter(|entry| entry.validation.is_finite());
        finite.min_by(|a, b| a.validation.total_cmp(&b.validation))
    }

    fn add(&mut self, entry: Entry) {
        match entry {
            Entry::Progress(progress) => {
                self.progress.truncate(self.progress.partition_point(|p| p.step < progress.step));
                self.validations.truncate(self.validations.partition_point(|v| v.step <= progress.step));
                self.progress.push(progress);
            }
            Entry::Validation(validation) => {
                self.validations.truncate(self.validations.partition_point(|v| v.step < validation.step));
                self.progress.truncate(self.progress.partition_point(|p| p.step <= validation.step));
                self.validations.push(validation);
            }
        }
    }
}

/// What is wrong with a line. The error of an untagged enum only states that no variant fits.
fn reason(line: &str, error: &serde_json::Error) -> String {
    if error.is_syntax() || error.is_eof() {
        return format!("no JSON: {error}");
    }
    match serde_json::from_str::<Progress>(line) {
        Err(error) if !line.contains("\"validation\"") => error.to_string(),
        _ => serde_json::from_str::<Validation>(line)
            .map_or_else(|error| error.to_string(), |_| error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<TrainingLog, LogError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        TrainingLog::read(file.path())
    }

    fn progress(step: u64) -> String {
        format!(
            r#"{{"step":{step},"seconds":1.5,"rate":0.001,"loss":2.0,"trajectory":1.0,"single":1.0,"probability":0.5,"spread":-0.5}}"#
        ) + "\n"
    }

    fn validation(step: u64, figure: f64) -> String {
        format!(
            r#"{{"step":{step},"validation":{figure},"sets":[{{"set":"sdd","agents":3,"best_of_modes":{{"ade_m":0.2,"fde_m":0.4}},"single":{{"ade_m":0.5,"fde_m":1.0}}}}]}}"#
        ) + "\n"
    }

    #[test]
    fn both_kinds_of_lines_are_read() {
        let text =
            progress(20) + &progress(40) + &validation(40, 0.9) + &progress(60) + &validation(60, 0.95);
        let log = read(&text).unwrap();
        assert_eq!((log.progress.len(), log.validations.len()), (3, 2));
        assert_eq!(log.best().unwrap().step, 40);
        assert_eq!(log.validations[0].sets[0].single.fde_m, 1.0);
        assert_eq!(log.progress[2].spread, -0.5);
    }

    #[test]
    fn a_resumed_training_replaces_what_was_lost() {
        let text = progress(20) + &progress(40) + &validation(40, 0.9) + &progress(60) + &validation(60, 0.7);
        let log = read(&(text + &progress(60) + &validation(60, 0.8) + &progress(80))).unwrap();
        let steps: Vec<u64> = log.progress.iter().map(|progress| progress.step).collect();
        assert_eq!(steps, [20, 40, 60, 80]);
        let figures: Vec<f64> = log.validations.iter().map(|entry| entry.validation).collect();
        assert_eq!(figures, [0.9, 0.8]);
    }

    #[test]
    fn a_line_that_was_cut_off_ends_the_log() {
        let whole = progress(20);
        let torn = whole.clone() + &progress(40)[..30];
        assert_eq!(read(&torn).unwrap(), read(&whole).unwrap());
    }

    #[test]
    fn bad_lines_are_named() {
        for (text, expected) in [
            (progress(20) + "{\"step\":\n", "line 2: no JSON"),
            (progress(20) + "{\"step\":30}\n", "line 2: missing field `seconds`"),
            ("{\"step\":30,\"validation\":\"low\"}\n".to_owned(), "line 1: invalid type: string \"low\""),
            ("\n".to_owned(), "no line of training"),
        ] {
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
