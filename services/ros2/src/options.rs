//! The options of the bridge: in pipeline.toml as `options = { … }` of its stages, and on the command line of
//! `stgdat ros2`.

use std::net::{IpAddr, Ipv4Addr};
use std::str::FromStr;

use clap::Args;
use run::Conflict;
use serde::{Deserialize, Deserializer};
use thiserror::Error;
use wire::MODES_MAX;

/// The environment variable of ROS 2 that holds the domain.
pub const DOMAIN_VARIABLE: &str = "ROS_DOMAIN_ID";
/// Largest domain whose ports exist.
const DOMAIN_MAX: u16 = 232;

/// Topics, by the names that Autoware gives them.
pub mod names {
    /// `DetectedObjects`, read.
    pub const DETECTED: &str = "/perception/object_recognition/detection/objects";
    /// `TrackedObjects`, written.
    pub const TRACKED: &str = "/perception/object_recognition/tracking/objects";
    /// `PredictedObjects`, written.
    pub const PREDICTED: &str = "/perception/object_recognition/objects";
    /// `TFMessage`: read by the source, and written for a run whose input is not from ROS.
    pub const TF: &str = "/tf";
    /// `TFMessage` of frames that do not move, read.
    pub const TF_STATIC: &str = "/tf_static";
    /// `Clock`, read if the time is simulated.
    pub const CLOCK: &str = "/clock";
    /// `DiagnosticArray`, written.
    pub const DIAGNOSTICS: &str = "/diagnostics";
    /// `MarkerArray` for rviz, written if the option is set.
    pub const MARKERS: &str = "/stgdat/markers";
}

/// What may be set of the bridge.
#[derive(Clone, Debug, PartialEq, Args, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// DDS domain; by default the value of ROS_DOMAIN_ID, or 0
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=i64::from(DOMAIN_MAX)))]
    pub domain: Option<u16>,
    /// Addresses of the network interfaces to use, separated by commas; by default only the loopback
    /// interface
    #[arg(long, value_name = "ADDRESS", value_delimiter = ',', default_values_t = [LOOPBACK])]
    pub interfaces: Vec<IpAddr>,
    /// Name a topic differently, such as /perception/object_recognition/objects:=/objects
    #[arg(long, value_name = "FROM:=TO")]
    pub remap: Vec<Remap>,
    /// World frame of the positions of tracks and forecasts
    #[arg(long, value_name = "FRAME", default_value = interop::autoware::MAP)]
    pub frame: String,
    /// Maximum number of paths of a predicted object, from 1 to 20
    #[arg(long, value_name = "N", default_value_t = PATHS, value_parser = paths)]
    pub paths: usize,
    /// Leave out objects if their forecasts are older than this, ms. Held forecasts count too
    #[arg(long = "max-age", value_name = "MS", value_parser = age)]
    pub max_age_ms: Option<f64>,
    /// Whether to publish the ego vehicle's pose on /tf. By default it is published only for recordings and
    /// generated scenes: a vehicle publishes its own pose
    #[arg(long, value_name = "true|false")]
    pub tf: Option<bool>,
    /// Publish markers for rviz on /stgdat/markers: boxes, paths and labels, with colors and dashes by cause
    #[arg(long)]
    pub markers: bool,
    /// Topics with `DetectedObjects`.
    #[arg(skip)]
    pub detections: Option<Vec<String>>,
    /// Topics with `TrackedObjects`.
    #[arg(skip)]
    pub tracks: Vec<String>,
    /// Pose (x, y in m, heading in rad) of the objects' frame in the world, for a system without `/tf`.
    #[arg(skip)]
    pub pose: Option<[f64; 3]>,
    /// Whether the publishers of the objects are not reliable.
    #[arg(skip)]
    pub best_effort: bool,
    /// Whether the time is the one of the topic `/clock`.
    #[arg(skip)]
    pub use_sim_time: bool,
    /// Whether tracks are predicted while no messages arrive.
    #[arg(skip = true)]
    pub predict: bool,
    /// Number of ticks after which the source ends.
    #[arg(skip)]
    pub ticks: Option<u64>,
}

const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
const PATHS: usize = 3;

impl Default for Options {
    fn default() -> Self {
        Self {
            domain: None,
            interfaces: vec![LOOPBACK],
            remap: Vec::new(),
            frame: interop::autoware::MAP.to_owned(),
            paths: PATHS,
            max_age_ms: None,
            tf: None,
            markers: false,
            detections: None,
            tracks: Vec::new(),
            pose: None,
            best_effort: false,
            use_sim_time: false,
            predict: true,
            ticks: None,
        }
    }
}

impl Options {
    /// Refuses values that the command line refuses, too.
    ///
    /// # Errors
    /// [`Conflict`] names the option.
    pub fn check(&self) -> Result<(), Conflict> {
        let refuse = |key, reason| Err(Conflict { key, reason, because: "" });
        if self.domain.is_some_and(|domain| domain > DOMAIN_MAX) {
            return refuse("domain", "`domain` is out of range: expected 0 to 232");
        }
        if !(1..=MODES_MAX).contains(&self.paths) {
            return refuse("paths", "`paths` is out of range: expected 1 to 20");
        }
        if self.max_age_ms.is_some_and(|age_ms| !age_ms.is_finite() || age_ms < 0.0) {
            return refuse("max_age_ms", "`max_age_ms` is not a time in ms");
        }
        if self.interfaces.is_empty() {
            return refuse("interfaces", "`interfaces` is empty: expected addresses such as \"127.0.0.1\"");
        }
        if self.pose.is_some_and(|pose| !pose.iter().all(|value| value.is_finite())) {
            return refuse("pose", "`pose` is not [x, y, heading]");
        }
        Ok(())
    }

    /// The DDS domain.
    ///
    /// # Errors
    /// [`UnknownDomain`] if the environment names none.
    pub fn domain(&self) -> Result<u16, UnknownDomain> {
        let named = || match std::env::var(DOMAIN_VARIABLE) {
            Ok(text) if !text.is_empty() => {
                let domain = text.parse().ok().filter(|domain| *domain <= DOMAIN_MAX);
                domain.ok_or(UnknownDomain(text))
            }
            _ => Ok(0),
        };
        self.domain.map_or_else(named, Ok)
    }

    /// The name of a topic after remapping.
    #[must_use]
    pub fn topic<'a>(&'a self, name: &'a str) -> &'a str {
        self.remap.iter().find(|remap| remap.from == name).map_or(name, |remap| &remap.to)
    }

    /// The topics with detected objects. Autoware's own, unless the source reads others.
    #[must_use]
    pub fn detections(&self) -> Vec<String> {
        let usual = || match self.tracks.is_empty() {
            true => vec![names::DETECTED.to_owned()],
            false => Vec::new(),
        };
        self.detections.clone().unwrap_or_else(usual)
    }
}

/// The variable [`DOMAIN_VARIABLE`] names no domain.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{DOMAIN_VARIABLE}={0}: expected a domain from 0 to {DOMAIN_MAX}")]
pub struct UnknownDomain(String);

/// Another name of a topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    from: String,
    to: String,
}

/// The text is not a remapping.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{0}`: expected two names of topics, as in /perception/object_recognition/objects:=/objects")]
pub struct UnknownRemap(String);

/// Whether a text is the whole name of a topic.
fn is_name(text: &str) -> bool {
    let is_part = |part: &str| {
        part.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_part))
}

impl FromStr for Remap {
    type Err = UnknownRemap;

    fn from_str(text: &str) -> Result<Self, UnknownRemap> {
        let names = text.split_once(":=").filter(|(from, to)| is_name(from) && is_name(to));
        let (from, to) = names.ok_or_else(|| UnknownRemap(text.to_owned()))?;
        Ok(Self { from: from.to_owned(), to: to.to_owned() })
    }
}

impl<'de> Deserialize<'de> for Remap {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

fn paths(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|number| (1..=MODES_MAX).contains(number));
    number.ok_or_else(|| format!("expected 1 to {MODES_MAX}"))
}

fn age(text: &str) -> Result<f64, String> {
    let age_ms = text.parse().ok().filter(|age_ms: &f64| age_ms.is_finite() && *age_ms >= 0.0);
    age_ms.ok_or_else(|| "expected a time in ms".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_have_autowares_names_unless_they_are_remapped() {
        let remap = vec!["/perception/object_recognition/objects:=/a/objects".parse().unwrap()];
        let options = Options { remap, ..Options::default() };
        assert_eq!(options.topic(names::PREDICTED), "/a/objects");
        assert_eq!(options.topic(names::TRACKED), "/perception/object_recognition/tracking/objects");
        for text in ["/a", "/a:=b", "a:=/b", "/a:=/b c", "/a/:=/b", "/1:=/b"] {
            assert_eq!(text.parse::<Remap>(), Err(UnknownRemap(text.to_owned())));
        }
    }

    #[test]
    fn only_the_loopback_is_used_unless_an_interface_is_named() {
        assert_eq!(Options::default().interfaces, [LOOPBACK]);
        assert_eq!(Options::default().check(), Ok(()));
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let wrong = [
            Options { domain: Some(233), ..Options::default() },
            Options { paths: 0, ..Options::default() },
            Options { paths: 21, ..Options::default() },
            Options { max_age_ms: Some(f64::NAN), ..Options::default() },
            Options { interfaces: Vec::new(), ..Options::default() },
            Options { pose: Some([0.0, f64::INFINITY, 0.0]), ..Options::default() },
        ];
        for options in wrong {
            assert!(options.check().is_err(), "{options:?}");
        }
    }

    #[test]
    fn tracks_replace_detections_unless_both_are_named() {
        let tracks = vec!["/tracks".to_owned()];
        assert_eq!(Options::default().detections(), [names::DETECTED]);
        let options = Options { tracks, ..Options::default() };
        assert!(options.detections().is_empty());
        let both = Options { detections: Some(vec!["/d".to_owned()]), ..options };
        assert_eq!(both.detections(), ["/d"]);
    }
}
