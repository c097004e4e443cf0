//! Recordings of data sets, cut into scenes, and the options that all evaluations share.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use data::sets::{DataSet, Part};
use data::{OpenOptions, Recording};
use lanes::{Coordinates, LaneMap};
use scene::ContextMap;

use crate::error::EvaluateError;
use crate::forecaster::{MapInput, WeightsChoice, site_map};
use crate::lines::ForecastLines;
use crate::noise::Noise;
use crate::scenes::{Cut, Scene};
use crate::threads;

/// Seed of latent variables, drawn directions and anchors.
pub const SEED: u64 = 1;

/// The map that the network reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MapChoice {
    /// No map.
    None,
    /// The map of the recording so far.
    Online,
    /// The map of the site's training recordings; no map if the site has none. In data sets without sites,
    /// the online map.
    Site,
}

/// The options of an evaluation.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder with the data sets in their published layout.
    pub data: PathBuf,
    /// The evaluated part of the data set: the test part for reports, the validation part to choose options.
    pub part: Part,
    /// The weights.
    pub weights: WeightsChoice,
    /// The map for models that read one.
    pub map: MapChoice,
    /// Whether forecasts follow the lanes of Lanelet2 maps: of INTERACTION's sites, in `interaction/maps`, and of
    /// driving recordings that have one, `driving_maps/SOURCE/RECORDING.osm`.
    pub lanes: bool,
    /// The sensor that sees the evaluated recordings of ETH/UCY, INTERACTION and driving sources. Training parts
    /// are seen without noise, and errors are relative to the recordings as they are.
    pub noise: Noise,
    /// Threads that share the work; results do not depend on their number.
    pub threads: usize,
    /// Where all forecasts behind the tables are written. Driving sources are then played in turn.
    pub lines: Option<Arc<ForecastLines>>,
    /// Names of the sources of driving recordings; all sources if empty.
    pub sources: Vec<String>,
    /// Whether the sampler uses evidence from matured forecasts on driving recordings.
    pub evidence: bool,
    /// Whether a driving source begins with a prior from the other sources. If not, it begins without a prior, so
    /// its evidence is independent of them.
    pub priors: bool,
}

impl Default for Options {
    /// The test part of sets in the current folder, by the embedded weights with an online map, on one thread.
    fn default() -> Self {
        Self {
            data: PathBuf::new(),
            part: Part::Test,
            weights: WeightsChoice::default(),
            map: MapChoice::Online,
            lanes: false,
            noise: Noise::default(),
            threads: 1,
            lines: None,
            sources: Vec::new(),
            evidence: true,
            priors: true,
        }
    }
}

/// A recording and its scenes.
pub struct Footage {
    /// The recording.
    pub recording: Recording,
    /// Windows.
    pub scenes: Vec<Scene>,
}

impl Footage {
    /// The site, which is the first part of the recording's name: `DR_USA_Roundabout_FT`.
    pub fn site(&self) -> String {
        self.recording.name.split('/').next().unwrap_or_default().to_owned()
    }
}

impl MapChoice {
    /// The chosen map. `Site` without a map of the site means no map: such a model learned from the maps of
    /// other sites, and an online map makes it worse than no map.
    #[must_use]
    pub const fn input(self, site: Option<&ContextMap>) -> MapInput<'_> {
        match (self, site) {
            (Self::Online, _) => MapInput::Online,
            (Self::Site, Some(site)) => MapInput::Site(site),
            _ => MapInput::None,
        }
    }

    /// The map in data sets without sites, and its name in reports.
    pub(crate) const fn without_sites(self) -> (MapInput<'static>, &'static str) {
        match self {
            Self::None => (MapInput::None, "none"),
            Self::Online | Self::Site => (MapInput::Online, "online"),
        }
    }

    /// The name in reports.
    pub const fn label(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Online => "online",
            Self::Site => "of the site's training recordings",
        }
    }
}

/// The map made from a site's recordings in `training`.
#[must_use]
pub fn map_of(training: &[Footage], site: &str) -> Option<ContextMap> {
    let of_site = training.iter().filter(|footage| footage.site() == site);
    site_map(of_site.flat_map(|footage| &footage.scenes))
}

impl Cut {
    /// Reads a recording and cuts it into scenes.
    pub(crate) fn read(&self, path: &Path, open: OpenOptions) -> Result<Footage, EvaluateError> {
        let recording = data::open_with(path, open)?;
        let scenes = self.scenes(&recording);
        Ok(Footage { recording, scenes })
    }
}

impl Options {
    /// The lanes of a site of INTERACTION; `None` if the options do not use lanes.
    pub(crate) fn lanes_of(&self, site: &str) -> Result<Option<Arc<LaneMap>>, EvaluateError> {
        if !self.lanes {
            return Ok(None);
        }
        let path = self.data.join("interaction/maps").join(format!("{site}.osm"));
        Ok(Some(Arc::new(LaneMap::open(&path, Coordinates::default())?)))
    }

    /// Reads recordings and cuts them into scenes.
    pub(crate) fn read(
        &self,
        paths: &[PathBuf],
        open: &OpenOptions,
        cut: &Cut,
    ) -> Result<Vec<Footage>, EvaluateError> {
        let read = |path: &PathBuf, (): &mut ()| cut.read(path, open.clone());
        threads::each(paths, self.threads, read).into_iter().collect()
    }

    /// Reads the recordings of a part of a data set and cuts them into scenes.
    ///
    /// # Errors
    /// [`EvaluateError`] if a recording can't be read.
    pub fn read_part(&self, set: DataSet, part: Part, cut: &Cut) -> Result<Vec<Footage>, EvaluateError> {
        self.read(&set.files(&self.data, part)?, &OpenOptions::of(set.format()), cut)
    }
}
