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
    if files.len() != 1 {
        return recording;
    }
    let [train, validation] = split_in_time(recording, 1.0 - 1.0 / PARTS as f64);
    if part == Part::Train { train } else { validation }
}

/// Cuts a recording in time: the first part has this share of the time from the first frame to the last.
#[must_use]
pub fn split_in_time(mut recording: Recording, share: f64) -> [Recording; 2] {
    let stamp_ns = |frame: Option<&data::Frame>| frame.map_or(0, |frame| frame.stamp_ns);
    let (first, last) = (stamp_ns(recording.frames.first()), stamp_ns(recording.frames.last()));
    let kept = ((1.0 - share.clamp(0.0, 1.0)) * (last - first) as f64).round() as i64;
    let cut_ns = last - kept;
    let end = recording.frames.partition_point(|frame| frame.stamp_ns < cut_ns);
    let frames = recording.frames.split_off(end);
    let later = Recording { frames, ..recording.clone() };
    [recording, later]
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
        let [train, validation] = split_in_time(recording, 0.8).map(|part| part.frames);
        assert_eq!((train.len(), validation.len()), (80, 20));
        assert!(train.iter().all(|frame| frame.stamp_ns < validation[0].stamp_ns));
    }
}
