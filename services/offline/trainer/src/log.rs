//! The log of a run: JSON lines, the input of `stgdat plot training`.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::TrainError;
use crate::objective::{LossParts, Objective};
use crate::score::SetScore;

/// Name of the file in the checkpoint folder.
const FILE: &str = "log.jsonl";
/// Number of updates that a line averages over.
const EVERY: u64 = 20;

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Line {
    /// Mean losses over the last updates.
    Losses {
        step: u64,
        seconds: f64,
        rate: f64,
        loss: f64,
        #[serde(flatten)]
        parts: LossParts,
    },
    /// A validation.
    Validation { step: u64, seconds: f64, validation: f64, sets: Vec<SetScore> },
}

impl Line {
    const fn step(&self) -> u64 {
        match self {
            Self::Losses { step, .. } | Self::Validation { step, .. } => *step,
        }
    }
}

/// A log file that is being written.
pub(crate) struct Log {
    path: PathBuf,
    sum: LossParts,
    summed: u64,
}

impl Log {
    /// The log in a folder, without the lines of updates after `step`, which a resumed run repeats.
    pub(crate) fn open(folder: &Path, step: u64) -> Result<Self, TrainError> {
        let path = folder.join(FILE);
        let io = |source| TrainError::Io { path: path.clone(), source };
        fs::create_dir_all(folder).map_err(io)?;
        let before = match fs::read_to_string(&path) {
            Ok(before) if step > 0 => before,
            Err(source) if step > 0 && source.kind() != ErrorKind::NotFound => return Err(io(source)),
            Ok(_) | Err(_) => String::new(),
        };
        let is_kept = |line: &&str| serde_json::from_str::<Line>(line).is_ok_and(|line| line.step() <= step);
        let kept: String = before.lines().filter(is_kept).flat_map(|line| [line, "\n"]).collect();
        fs::write(&path, kept).map_err(io)?;
        Ok(Self { path, sum: LossParts::default(), summed: 0 })
    }

    /// Counts the losses of an update, after `step` updates.
    pub(crate) fn update(
        &mut self,
        step: u64,
        (seconds, rate): (f64, f64),
        (objective, parts): (&Objective, LossParts),
    ) -> Result<(), TrainError> {
        self.sum = self.sum.plus(parts);
        self.summed += 1;
        if !step.is_multiple_of(EVERY) {
            return Ok(());
        }
        let parts = self.sum.times(1.0 / self.summed as f32);
        (self.sum, self.summed) = (LossParts::default(), 0);
        self.write(&Line::Losses { step, seconds, rate, loss: objective.weigh(parts), parts })
    }

    /// Appends a line.
    pub(crate) fn write(&self, line: &Line) -> Result<(), TrainError> {
        let io = |source| TrainError::Io { path: self.path.clone(), source };
        let mut text = serde_json::to_string(line).map_err(std::io::Error::from).map_err(io)?;
        text.push('\n');
        let mut file = fs::OpenOptions::new().append(true).open(&self.path).map_err(io)?;
        file.write_all(text.as_bytes()).map_err(io)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resumed_log_drops_lines_after_the_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = Log::open(folder.path(), 0).unwrap();
        let parts = LossParts { trajectory: 0.5, ..LossParts::default() };
        for step in 1..=3 * EVERY {
            log.update(step, (step as f64, 0.1), (&Objective::plus(), parts.times(step as f32))).unwrap();
        }
        let validation = Line::Validation { step: EVERY, seconds: 1.0, validation: 0.9, sets: Vec::new() };
        log.write(&validation).unwrap();
        Log::open(folder.path(), 2 * EVERY).unwrap();
        let text = fs::read_to_string(folder.path().join(FILE)).unwrap();
        let lines: Vec<Line> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.iter().map(Line::step).collect::<Vec<_>>(), [EVERY, 2 * EVERY, EVERY]);
        let mean = (EVERY + 1) as f32 / 2.0;
        assert!(matches!(lines[0], Line::Losses { parts, loss, .. }
                if (parts.trajectory - 0.5 * mean).abs() < 1e-3 && loss == f64::from(parts.trajectory)));
        assert_eq!(lines[2], validation);
    }
}
