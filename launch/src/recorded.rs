//! Recordings that verbs read.

use std::path::Path;

use recording::{Ending, ReadError, Recording};
use run::Exit;
use wire::{ForecastsTopic, Topic};

use console::failure::Failure;

/// Opens a recording and reads all of it; returns its damaged parts too.
pub fn open_and_check(path: &Path) -> Result<(Recording, Vec<ReadError>), Failure> {
    let recording = Recording::open(path).map_err(Failure::data)?;
    let damages = recording.damages();
    Ok((recording, damages))
}

/// Opens a recording that has forecasts, and warns if its end is missing.
pub fn open(path: &Path) -> Result<Recording, Failure> {
    let recording = Recording::open(path).map_err(Failure::data)?;
    if let Ending::Incomplete { at, why } = recording.ending() {
        tracing::warn!("{}: INCOMPLETE: readable up to byte {at}: {why}", path.display());
    }
    if !recording.has_topic(ForecastsTopic::NAME) {
        let why = "the forecasts were not recorded, whose headers tell what each stage did";
        return Err(Failure::data_about(path.display(), why));
    }
    Ok(recording)
}

/// Fails with the first damaged part, after all readable parts were used.
pub fn end_with(damages: Vec<ReadError>) -> Result<Exit, Failure> {
    let more = damages.len().saturating_sub(1);
    match damages.into_iter().next() {
        None => Ok(Exit::Done),
        Some(first) => {
            if more > 0 {
                tracing::warn!("{more} more parts of the file are damaged");
            }
            Err(Failure::data(first))
        }
    }
}

#[cfg(test)]
pub mod tests;
