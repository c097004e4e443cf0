//! Counts windows and agents of the published protocols in the real recordings.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::path::PathBuf;

use data::sets::{DataSet, Fold, Part};
use evaluator::{Cut, Scene};
use testing::{public_recording, recordings_folder};

const CUT: Cut = Cut { history_len: 8, horizon_len: 12, dt_s: 0.4, from_positions: false };

/// The folder with the recordings; `None` if they are not there.
fn recordings(set: &str) -> Option<PathBuf> {
    public_recording(set).map(|_| recordings_folder())
}

/// Counts windows with at least `least` complete agents, and the agents in them.
fn count(scenes: &[Scene], least: usize) -> (usize, usize) {
    let lens = scenes.iter().map(|scene| scene.complete().len()).filter(|len| *len >= least);
    lens.fold((0, 0), |(windows, agents), len| (windows + 1, agents + len))
}

fn test_scenes(root: &std::path::Path, set: DataSet) -> Vec<Scene> {
    let files = set.files(root, Part::Test).unwrap();
    files.iter().flat_map(|file| CUT.scenes(&data::open(file, Some(set.format())).unwrap())).collect()
}

#[test]
fn the_folds_have_their_published_windows_and_pedestrians() {
    let Some(root) = recordings("eth_ucy") else { return };
    let published = [
        (Fold::Eth, (70, 181), (253, 364)),
        (Fold::Hotel, (301, 1053), (445, 1197)),
        (Fold::Univ, (947, 24334), (947, 24334)),
        (Fold::Zara1, (602, 2253), (705, 2356)),
        (Fold::Zara2, (921, 5833), (998, 5910)),
    ];
    for (fold, company, all) in published {
        let scenes = test_scenes(&root, DataSet::EthUcyFold(fold));
        assert_eq!(count(&scenes, 2), company, "{}, two or more", fold.name());
        assert_eq!(count(&scenes, 1), all, "{}, one or more", fold.name());
    }
}

#[test]
fn the_drone_has_its_published_tracks() {
    let Some(root) = recordings("sdd") else { return };
    assert_eq!(count(&test_scenes(&root, DataSet::SddTrajnet), 1).1, 2829);
}
