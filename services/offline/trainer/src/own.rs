//! A user's own recordings: the training options, and the split into training and validation.
//!
//! No frame is in both parts. With several recordings, the last fifth validates, at least one recording. A
//! single recording is cut in time: its first four fifths train, the rest validates.

use std::path::{Path, PathBuf};

use data::Recording;
use data::sets::{DataSet, Part};
use nn::Weights;

use crate::checkpoint::write_whole;
use crate::options::TrainOptions;
use crate::{OptimiserOptions, TrainError, recipe};

/// One of this number of parts validates.
const PARTS: usize = 5;
/// File name of the embedded weights in the checkpoint folder.
const ONBOARD: &str = "onboard.safetensors";

/// The options of a training on the user's own recordings, with the model of `onboard`.
#[must_use]
pub fn own(files: Vec<PathBuf>) -> TrainOptions {
    let sets = || vec![DataSet::Own.name().to_owned()];
    TrainOptions {
        recipe: None,
        files,
        sets: sets(),
        validation_sets: sets(),
        out: "weights.safetensors".into(),
        resume: true,
        steps: 400,
        validate_every: 50,
        validation_agents: 1_000,
        site_map: 0.0,
        workers: 2,
        optimiser: OptimiserOptions {
            learning_rate: 1e-3,
            warm_up_steps: 20,
            average_decay: 0.98,
            ..OptimiserOptions::default()
        },
        ..recipe("onboard").unwrap_or_default()
    }
}

/// Makes a training begin with the embedded weights, which are written to its checkpoint folder.
///
/// # Errors
/// [`TrainError::Io`] if they can't be written.
pub fn begin_with_onboard(options: &mut TrainOptions) -> Result<(), TrainError> {
    let folder = &options.checkpoints;
    let path = folder.join(ONBOARD);
    std::fs::create_dir_all(folder).map_err(|source| TrainError::Io { path: folder.clone(), source })?;
    write_whole(&path, Weights::onboard_file())?;
    options.begin_with = vec![path];
    Ok(())
}

pub(crate) fn files_of(files: &[PathBuf], part: Part) -> &[PathBuf] {
    if files.len() < 2 {
        return files;
    }
    let (train, validation) = files.split_at(files.len() - files.len().div_ceil(PARTS));
    if part == Part::Train { train } else { validation }
}

/// What a part has of a recording: all of it, or a part of the time if there is no other file.
pub(crate) fn within(recording: Recording, files: &[PathBuf], part: Part) -> Recording {
    if files.len() == 1 { cut_in_time(recording, part) } else { recording }
}

/// The frames of the only recording that belong to a part.
fn cut_in_time(mut recording: Recording, part: Part) -> Recording {
    let cut_ns = cut_ns(&recording);
    recording.frames.retain(|frame| (frame.stamp_ns < cut_ns) == (part == Part::Train));
    recording
}

/// The time from which frames belong to the validation.
fn cut_ns(recording: &Recording) -> i64 {
    let stamp_ns = |frame: Option<&data::Frame>| frame.map_or(0, |frame| frame.stamp_ns);
    let (first, last) = (stamp_ns(recording.frames.first()), stamp_ns(recording.frames.last()));
    let part = (last - first) / PARTS as i64;
    last - part
}

/// The recordings that validate a training on these files.
///
/// # Errors
/// [`data::ReadError`] if one can't be read.
pub fn validation_recordings(files: &[PathBuf]) -> Result<Vec<Recording>, data::ReadError> {
    let of_part = files_of(files, Part::Validation)
        .iter()
        .map(|path| Ok(within(data::open(path, None)?, files, Part::Validation)));
    of_part.collect()
}

/// Describes the split.
pub(crate) fn split(files: &[PathBuf]) -> String {
    let names = |part| {
        let names = files_of(files, part).iter().map(|path| Path::display(path).to_string());
        names.collect::<Vec<_>>().join(", ")
    };
    match files {
        [one] => format!("{}: the first 80 % of the time train, the rest validates", one.display()),
        _ => format!("training: {}\nvalidation: {}", names(Part::Train), names(Part::Validation)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_frame_trains_and_validates() {
        let paths: Vec<PathBuf> = (0..7).map(|number| PathBuf::from(format!("{number}.csv"))).collect();
        for len in 2..=7 {
            let [train, validation] =
                [Part::Train, Part::Validation].map(|part| files_of(&paths[..len], part));
            assert_eq!([train, validation].concat(), paths[..len]);
            assert_eq!(validation.len(), len.div_ceil(5), "{len} files");
        }
        let frames =
            (0..100).map(|number| data::Frame { stamp_ns: 7 + number * 100, ..data::Frame::default() });
        let recording = Recording { frames: frames.collect(), ..Recording::default() };
        let [train, validation] =
            [Part::Train, Part::Validation].map(|part| cut_in_time(recording.clone(), part).frames);
        assert_eq!((train.len(), validation.len()), (80, 20));
        assert!(train.iter().all(|frame| frame.stamp_ns < validation[0].stamp_ns));
    }
}
