use std::path::PathBuf;
use std::str::FromStr;

use data::{Format, FrameRate, SceneOptions};
use run::Declaration;
use schemars::JsonSchema;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use wire::{AGENTS_MAX, DetectionsTopic, StageId, Topic, TruthTopic};

/// The source.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME]);

/// What may be set of the source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// File or folder of the recording to play; by default the generated scene.
    #[schemars(extend("format" = "path"))]
    pub recording: Option<PathBuf>,
    /// Format of the recording; detected if not given.
    #[serde(deserialize_with = "named", serialize_with = "name")]
    #[schemars(with = "Option<String>", extend("expected" = formats()))]
    pub format: Option<Format>,
    /// Frame rate of the recording, Hz, if its files contain frame numbers but no times; by default the
    /// format's usual rate.
    #[schemars(range(min = FrameRate::MIN_HZ, max = FrameRate::MAX_HZ))]
    pub fps: Option<f64>,
    /// Topics of a bag whose objects are read. The default is Autoware's own detections or tracks, or else every
    /// topic with detections.
    pub topics: Vec<String>,
    /// Number of agents in the generated scene; fewer if there is no room.
    #[schemars(range(min = 1, max = AGENTS_MAX))]
    pub agents: usize,
    /// Noise of the positions that the generated scene's detector measures, m on each axis. Headings and sizes
    /// have noise in proportion: 2° and 3 % at 0.1 m. With 0 they are exact. By default 0.15 for vehicles, 0.12
    /// for cyclists, 0.08 for pedestrians, and 2.3° for headings.
    #[schemars(range(min = 0.0, max = SceneOptions::NOISE_MAX_M))]
    pub noise_m: Option<f32>,
    /// Number of ticks after which the scene ends; by default the whole recording, or 20 s of a generated
    /// scene.
    #[schemars(range(min = 1))]
    pub ticks: Option<u64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            recording: None,
            format: None,
            fps: None,
            topics: Vec::new(),
            agents: 32,
            noise_m: None,
            ticks: None,
        }
    }
}

fn formats() -> String {
    format!("one of {}", Format::ALL.map(Format::name).join(", "))
}

fn named<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Format>, D::Error> {
    let name = Option::<String>::deserialize(deserializer)?;
    name.map(|name| Format::from_str(&name).map_err(D::Error::custom)).transpose()
}

fn name<S: Serializer>(format: &Option<Format>, serializer: S) -> Result<S::Ok, S::Error> {
    format.map(Format::name).serialize(serializer)
}
