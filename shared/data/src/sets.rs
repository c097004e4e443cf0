//! The data sets and their train, validation and test parts, as lists of files.
//!
//! Validation parts where a set has none: of SDD TrajNet the scenes `gates_*` and `nexus_*`; of each site of
//! INTERACTION the fifth of the recordings before the last fifth, which is the test part; of each source of
//! `driving` the last fifth of the recordings, where it has five or more; of VCI-DUT the
//! intersections 11 and 12; of KITTI the sequences from 0016 on.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::{Format, ReadError};

/// A data set, laid out as published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DataSet {
    /// One of the leave-one-out folds of ETH/UCY.
    EthUcyFold(Fold),
    /// Every scene of ETH/UCY once, by the scenes' own train and validation parts; no test part.
    EthUcy,
    /// Stanford Drone, TrajNet split.
    SddTrajnet,
    /// Stanford Drone, annotations of whole videos; no test part.
    SddRaw,
    /// INTERACTION, vehicles with the pedestrians of the same recordings.
    Interaction,
    /// VCI-DUT, vehicles with pedestrians; no test part.
    VciDut,
    /// KITTI tracking, true tracks; no test part.
    KittiLabels,
    /// KITTI tracking, a detector's output; no test part.
    KittiDetections,
    /// Vehicle tracks of real roads by source, in the project's own format; no test part.
    Driving,
    /// Scenes of Waymo Open Motion in the project's own format, for validation alone: their licence would
    /// bind weights that are trained on them.
    Womd,
}

/// The scene that a fold of ETH/UCY leaves out of training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fold {
    /// BIWI ETH.
    Eth,
    /// BIWI HOTEL.
    Hotel,
    /// UCY students.
    Univ,
    /// UCY zara 1.
    Zara1,
    /// UCY zara 2.
    Zara2,
}

/// A part of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// For training.
    Train,
    /// For the choice of weights and parameters.
    Validation,
    /// For reported figures.
    Test,
}

impl Fold {
    /// All folds, in the order of the literature's tables.
    pub const ALL: [Self; 5] = [Self::Eth, Self::Hotel, Self::Univ, Self::Zara1, Self::Zara2];

    /// The fold's folder.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Eth => "eth",
            Self::Hotel => "hotel",
            Self::Univ => "univ",
            Self::Zara1 => "zara1",
            Self::Zara2 => "zara2",
        }
    }
}

impl Part {
    /// The part's name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

impl DataSet {
    /// The name used on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::EthUcyFold(fold) => fold.name(),
            Self::EthUcy => "eth-ucy",
            Self::SddTrajnet => "sdd-trajnet",
            Self::SddRaw => "sdd-raw",
            Self::Interaction => "interaction",
            Self::VciDut => "vci-dut",
            Self::KittiLabels => "kitti-labels",
            Self::KittiDetections => "kitti-detections",
            Self::Driving => "driving",
            Self::Womd => WOMD,
        }
    }

    /// The format of the set's files.
    #[must_use]
    pub const fn format(self) -> Format {
        match self {
            Self::EthUcyFold(_) | Self::EthUcy => Format::EthUcy,
            Self::SddTrajnet => Format::SddTrajnet,
            Self::SddRaw => Format::SddRaw,
            Self::Interaction => Format::Interaction,
            Self::VciDut => Format::VciDut,
            Self::KittiLabels => Format::KittiLabels,
            Self::KittiDetections => Format::KittiDetections,
            Self::Driving | Self::Womd => Format::Csv,
        }
    }

    /// The files to [`open`](crate::open) for a part, below the folder `root` that holds all sets, sorted by
    /// path.
    ///
    /// # Errors
    /// [`ReadError::Io`] where a folder of the set can't be listed.
    pub fn files(self, root: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
        match self {
            Self::EthUcyFold(fold) => list(&root.join("eth_ucy").join(fold.name()).join(folder(part))),
            Self::EthUcy => scenes_once(&root.join("eth_ucy"), part),
            Self::SddTrajnet => {
                let taken = if part == Part::Test { "test" } else { "train" };
                let files = list(&root.join("sdd/trajnet").join(taken))?;
                Ok(files
                    .into_iter()
                    .filter(|file| part == Part::Test || held_out_scene(file) == part)
                    .collect())
            }
            Self::SddRaw => videos(&root.join("sdd/raw"), part),
            Self::Interaction => sites(&root.join("interaction/recorded_trackfiles"), part),
            Self::VciDut => {
                let files =
                    list(&root.join("vci_dut"))?.into_iter().filter(|file| named(file).contains("_veh_"));
                let validates = |file: &PathBuf| ["_11_", "_12_"].iter().any(|n| named(file).contains(n));
                Ok(files.filter(|file| in_part(validates(file), part)).collect())
            }
            Self::KittiLabels => sequences(&root.join("kitti_tracking/label"), part),
            Self::KittiDetections => sequences(&root.join("kitti_tracking/detection/Car"), part),
            Self::Driving => sources(&root.join("driving"), part),
            Self::Womd if part == Part::Validation => list(&root.join("driving").join(WOMD)),
            Self::Womd => Ok(Vec::new()),
        }
    }
}

/// The folder of the source that is for validation alone.
const WOMD: &str = "womd";
/// A source of fewer recordings has no validation part.
const VALIDATED_MIN: usize = 5;

/// The recordings of all sources but [`WOMD`]; the last fifth of each is for validation.
fn sources(root: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for source in list(root)?.iter().filter(|source| source.is_dir() && named(source) != WOMD) {
        let mut recordings = list(source)?;
        let validates = if recordings.len() < VALIDATED_MIN { 0 } else { recordings.len() / 5 };
        let learned = recordings.len() - validates;
        files.extend(match part {
            Part::Train => recordings.drain(..learned),
            Part::Validation => recordings.drain(learned..),
            Part::Test => continue,
        });
    }
    Ok(files)
}

/// The folder of a fold's part.
const fn folder(part: Part) -> &'static str {
    match part {
        Part::Train => "train",
        Part::Validation => "val",
        Part::Test => "test",
    }
}

/// Whether a file belongs to a part of a set that has two.
fn in_part(validates: bool, part: Part) -> bool {
    part == if validates { Part::Validation } else { Part::Train }
}

/// Each scene once: the folds share the files of the scenes that they do not leave out, so each file name is
/// taken once.
fn scenes_once(root: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
    if part == Part::Test {
        return Ok(Vec::new());
    }
    let mut files: Vec<PathBuf> = Vec::new();
    for fold in Fold::ALL {
        for file in list(&root.join(fold.name()).join(folder(part)))? {
            if !files.iter().any(|taken| taken.file_name() == file.file_name()) {
                files.push(file);
            }
        }
    }
    files.sort();
    Ok(files)
}

/// The part of a training scene of Stanford Drone.
fn held_out_scene(path: &Path) -> Part {
    let validates = ["gates", "nexus"].iter().any(|scene| named(path).starts_with(scene));
    if validates { Part::Validation } else { Part::Train }
}

fn videos(root: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for scene in list(root)?.iter().filter(|scene| scene.is_dir() && held_out_scene(scene) == part) {
        files.extend(list(scene)?.into_iter().map(|video| video.join("annotations.txt")));
    }
    Ok(files)
}

fn sites(root: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for site in list(root)? {
        let mut recordings = list(&site)?;
        recordings.retain(|file| named(file).starts_with("vehicle_tracks_"));
        let fifth = (recordings.len() / 5).max(1);
        let tests = recordings.len().saturating_sub(fifth);
        let validates = tests.saturating_sub(fifth);
        files.extend(match part {
            Part::Train => recordings.drain(..validates),
            Part::Validation => recordings.drain(validates..tests),
            Part::Test => recordings.drain(tests..),
        });
    }
    Ok(files)
}

fn sequences(folder: &Path, part: Part) -> Result<Vec<PathBuf>, ReadError> {
    let validates = |file: &PathBuf| named(file).as_str() >= "0016";
    Ok(list(folder)?.into_iter().filter(|file| in_part(validates(file), part)).collect())
}

fn named(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// What a folder holds, sorted by name.
fn list(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let failed = |source: io::Error| ReadError::Io { path: folder.to_owned(), source };
    let entries = fs::read_dir(folder).map_err(failed)?;
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>().map_err(failed)?;
    files.sort();
    Ok(files)
}
