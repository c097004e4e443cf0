use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Where the localiser's context map comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum MapChoice {
    /// Gathered from the tracks while the pipeline runs, the past only.
    #[default]
    Online,
    /// No map: every patch is zero.
    None,
    /// A file that `stgdat map` wrote.
    File(PathBuf),
}

/// An empty name for a map.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("expected `online`, `none` or the path of a map")]
pub struct UnknownMap;

impl FromStr for MapChoice {
    type Err = UnknownMap;

    fn from_str(text: &str) -> Result<Self, UnknownMap> {
        match text {
            "online" => Ok(Self::Online),
            "none" => Ok(Self::None),
            "" => Err(UnknownMap),
            path => Ok(Self::File(path.into())),
        }
    }
}

/// How the sampler carries the spread of the controls on to positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Propagation {
    /// Gaussians through the derivatives of the motion model.
    #[default]
    Linearised,
    /// Particles through the motion model itself.
    MonteCarlo,
}

/// A name that stands for no propagation.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown propagation \"{0}\": expected linearised or monte-carlo")]
pub struct UnknownPropagation(String);

impl FromStr for Propagation {
    type Err = UnknownPropagation;

    fn from_str(name: &str) -> Result<Self, UnknownPropagation> {
        match name {
            "linearised" => Ok(Self::Linearised),
            "monte-carlo" => Ok(Self::MonteCarlo),
            _ => Err(UnknownPropagation(name.to_owned())),
        }
    }
}

/// What moves a track between two detections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Prior {
    /// Its type's process model alone.
    Kinematic,
    /// The newest forecast of it, where there is one, beside the process model.
    #[default]
    Learned,
}

/// A name that stands for no prior.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown prior \"{0}\": expected kinematic or learned")]
pub struct UnknownPrior(String);

impl FromStr for Prior {
    type Err = UnknownPrior;

    fn from_str(name: &str) -> Result<Self, UnknownPrior> {
        match name {
            "kinematic" => Ok(Self::Kinematic),
            "learned" => Ok(Self::Learned),
            _ => Err(UnknownPrior(name.to_owned())),
        }
    }
}

/// How detections without a trusted identity correct tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Association {
    /// Each track by the one that the cheapest assignment gives it.
    #[default]
    Assignment,
    /// Each published track by all that may be its own, by how probable that is.
    Jpda,
}

/// A name that stands for no association.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown association \"{0}\": expected assignment or jpda")]
pub struct UnknownAssociation(String);

impl FromStr for Association {
    type Err = UnknownAssociation;

    fn from_str(name: &str) -> Result<Self, UnknownAssociation> {
        match name {
            "assignment" => Ok(Self::Assignment),
            "jpda" => Ok(Self::Jpda),
            _ => Err(UnknownAssociation(name.to_owned())),
        }
    }
}

/// What the sensor can see at best: a sector of the ground about the ego's heading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Its width, within (0, 360].
    pub width_deg: f64,
    /// Its radius, within (0, 1000].
    pub range_m: f64,
}

/// Text that stands for no view.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown view \"{0}\": expected WIDTH,RANGE, up to 360 degrees and 1000 m, as in 90,80")]
pub struct UnknownView(String);

impl FromStr for View {
    type Err = UnknownView;

    fn from_str(text: &str) -> Result<Self, UnknownView> {
        let number = |text: &str, most: f64| {
            let number = text.trim().parse::<f64>().ok()?;
            (number > 0.0 && number <= most).then_some(number)
        };
        let view = text.split_once(',').and_then(|(width, range)| {
            Some(Self { width_deg: number(width, 360.0)?, range_m: number(range, 1000.0)? })
        });
        view.ok_or_else(|| UnknownView(text.to_owned()))
    }
}

/// Settings of the stages; each stage reads its own and pipeline.toml may set no others.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Sampler: how long after its release a tick waits for its controls.
    pub deadline_ms: Option<f64>,
    /// Extractor, decoder: threads that share a tick's rows.
    pub workers: Option<usize>,
    /// Localiser: where the context map comes from.
    pub map: Option<MapChoice>,
    /// Tracker: what moves a track between two detections.
    pub prior: Option<Prior>,
    /// Tracker: how detections correct tracks.
    pub association: Option<Association>,
    /// Tracker: what the sensor can see at best, where a frame tells that it was made from the ego.
    pub view: Option<View>,
    /// Sampler: whether the memory of the place takes part.
    pub recall: Option<bool>,
    /// Sampler: the file that the memory of the place begins with and ends in.
    pub memory: Option<PathBuf>,
    /// Sampler: how the spread of the controls is carried on.
    pub propagation: Option<Propagation>,
    /// Sampler: particles per mode of the Monte Carlo propagation.
    pub particles: Option<usize>,
}
