//! The data sets and their training, validation and test parts, as lists of files.
//!
//! Sets without a published validation part have these:
//!
//! | set | validation part |
//! |---|---|
//! | SDD TrajNet | the scenes `gates_*` and `nexus_*` |
//! | INTERACTION | of each site the fifth of the recordings before the last fifth, which is the test part |
//! | `driving` | of each source with five or more recordings the last fifth |
//! | VCI-DUT | the intersections 11 and 12 |
//! | KITTI | the sequences from 0016 on |

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::{Format, GeneratedScene, ReadError, Recording, SceneOptions};

/// A data set, laid out as published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DataSet {
    /// One of the leave-one-out folds of ETH/UCY.
    EthUcyFold(Fold),
    /// Every scene of ETH/UCY once, with the scenes' own training and validation parts; no test part.
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
    /// The sources of [`Driving`](Self::Driving) that belong to NGSIM, which has no restrictions of use; no
    /// test part.
    Ngsim,
    /// Generated scenes, which need no files; no test part.
    Generated,
    /// Scenes of Waymo Open Motion in the project's own format. They are for validation only, because their
    /// licence would bind weights that are trained on them.
    Womd,
    /// A user's own recordings in any format, listed file by file.
    Own,
}

wire::named! {
    /// The scene that a fold of ETH/UCY leaves out of training.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Fold {
        /// BIWI ETH.
        Eth => "eth",
        /// BIWI HOTEL.
        Hotel => "hotel",
        /// UCY students.
        Univ => "univ",
        /// UCY zara 1.
        Zara1 => "zara1",
        /// UCY zara 2.
        Zara2 => "zara2",
    }
}

wire::named! {
    /// A part of a data set.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Part {
        /// For training.
        Train => "train",
        /// For the choice of weights and parameters.
        Validation => "validation",
        /// For reported figures.
        Test => "test",
    }
}

impl DataSet {
    /// The name used on the command line and in reports.
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
            Self::Ngsim => "ngsim",
            Self::Generated => "generated",
            Self::Womd => WOMD,
            Self::Own => "own",
        }
    }

    /// The format of the set's files.
    pub const fn format(self) -> Format {
        match self {
            Self::EthUcyFold(_) | Self::EthUcy => Format::EthUcy,
            Self::SddTrajnet => Format::SddTrajnet,
            Self::SddRaw => Format::SddRaw,
            Self::Interaction => Format::Interaction,
            Self::VciDut => Format::VciDut,
            Self::KittiLabels => Format::KittiLabels,
            Self::KittiDetections => Format::KittiDetections,
            Self::Driving | Self::Ngsim | Self::Generated | Self::Womd | Self::Own => Format::Csv,
        }
    }

    /// The permitted uses of the set, in the publishers' words; by source if they differ.
    pub const fn licences(self) -> &'static [(&'static str, &'static str)] {
        const NGSIM: (&str, &str) = ("ngsim", "public US data");
        match self {
            Self::EthUcyFold(_) | Self::EthUcy => &[("eth-ucy", "none stated")],
            Self::SddTrajnet | Self::SddRaw => &[("sdd", "CC BY-NC-SA 3.0")],
            Self::Interaction => &[("interaction", "non-commercial research")],
            Self::VciDut => &[("vci-dut", "none stated")],
            Self::KittiLabels | Self::KittiDetections => &[("kitti", "CC BY-NC-SA 3.0")],
            Self::Driving => &[
                ("apolloscape", "non-commercial"),
                ("av2_sensor", "CC BY-NC-SA 4.0"),
                ("mona", "research; none stated"),
                NGSIM,
                ("nuscenes_mini", "CC BY-NC-SA 4.0"),
            ],
            Self::Ngsim => &[NGSIM],
            Self::Generated => &[("generated", "this project's own")],
            Self::Womd => &[("womd", "Waymo non-commercial")],
            Self::Own => &[("own", "as of the recordings")],
        }
    }

    /// Opens one of the set's [`files`](Self::files), or generates the scene of that name.
    ///
    /// # Errors
    /// [`ReadError`] names the file and the problem.
    pub fn open(self, file: &Path) -> Result<Recording, ReadError> {
        match self {
            Self::Generated => generated(file),
            Self::Own => crate::open(file, None),
            _ => crate::open(file, Some(self.format())),
        }
    }

    /// The files to [`open`](Self::open) for a part, in the folder `root` of all sets, sorted by path.
    /// Generated scenes have no files; their names are numbers.
    ///
    /// # Errors
    /// [`ReadError::Io`] if a folder of the set can't be listed.
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
            Self::Driving => sources(&root.join("driving"), part, |source| source != WOMD),
            Self::Ngsim => sources(&root.join("driving"), part, |source| source.starts_with("ngsim_")),
            Self::Generated => Ok(generated_scenes(part)),
            Self::Womd if part == Part::Validation => list(&root.join("driving").join(WOMD)),
            Self::Womd | Self::Own => Ok(Vec::new()),
        }
    }
}

/// The folder of the source that is for validation only.
const WOMD: &str = "womd";
/// Minimum number of recordings of a source with a validation part.
const VALIDATED_MIN: usize = 5;

/// Number of generated scenes in the training and in the validation part.
const GENERATED_LEN: [u64; 2] = [40, 4];
/// Frames of a generated scene, one minute.
const GENERATED_FRAMES: usize = 750;
/// Agents of the generated scenes, in turn.
const GENERATED_AGENTS: [usize; 4] = [12, 24, 40, 64];

/// Names of the generated scenes of a part. The numbers are the scenes' seeds.
fn generated_scenes(part: Part) -> Vec<PathBuf> {
    let [learned, validated] = GENERATED_LEN;
    let seeds = match part {
        Part::Train => 1..=learned,
        Part::Validation => learned + 1..=learned + validated,
        Part::Test => return Vec::new(),
    };
    seeds.map(|seed| PathBuf::from(format!("generated/{seed:04}"))).collect()
}

/// The scene with this name, observed without errors.
fn generated(name: &Path) -> Result<Recording, ReadError> {
    let unknown = || ReadError::Io { path: name.to_owned(), source: io::ErrorKind::NotFound.into() };
    let seed: u64 = named(name).parse().map_err(|_| unknown())?;
    let options = SceneOptions {
        agents: GENERATED_AGENTS[(seed % GENERATED_AGENTS.len() as u64) as usize],
        seed,
        identities: true,
        speeds: true,
        position_sigma_m: [0.0; 3],
        heading_sigma_rad: 0.0,
        speed_sigma_mps: 0.0,
        size_sigma_share: 0.0,
        miss_probability: 0.0,
        clutter_mean: 0.0,
        occlusion: false,
        ..SceneOptions::default()
    };
    let scene = GeneratedScene::new(options).map_err(|_| unknown())?;
    let mut recording = scene.recording(GENERATED_FRAMES);
    recording.name = name.display().to_string();
    Ok(recording)
}

/// The recordings of the sources whose folder `takes` accepts. The last fifth of each source is for
/// validation.
fn sources(root: &Path, part: Part, takes: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, ReadError> {
    let mut files = Vec::new();
    for source in list(root)?.iter().filter(|source| source.is_dir() && takes(&named(source))) {
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

/// Whether a file belongs to a part of a set with two parts.
fn in_part(validates: bool, part: Part) -> bool {
    part == if validates { Part::Validation } else { Part::Train }
}

/// Each scene once. Folds share the files of the scenes that they do not leave out, so each file name is
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

/// The entries of a folder, sorted by name.
fn list(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let failed = |source: io::Error| ReadError::Io { path: folder.to_owned(), source };
    let entries = fs::read_dir(folder).map_err(failed)?;
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>().map_err(failed)?;
    files.sort();
    Ok(files)
}
