//! Protocols: which windows, weights and agents each evaluation uses.

mod eth_ucy;
mod files;
mod interaction;
mod sdd;

use std::path::{Path, PathBuf};

use std::sync::Arc;

use data::sets::{DataSet, Part};
use data::{OpenOptions, Recording};
use lanes::{Coordinates, LaneMap};
use scene::ContextMap;

pub use eth_ucy::eth_ucy;
pub use files::Evaluation;
pub(crate) use files::SUBSETS;
pub use interaction::{InteractionPart, interaction};
pub use sdd::sdd;

use crate::judge::Block;
use crate::maps::{MapInput, site_map};
use crate::weights::{Model, WeightsChoice};
use crate::{Baselines, Cut, EvaluateError, ForecastLines, Judge, Noise, Scene, Subset, threads};

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
    /// Whether forecasts follow the lanes of each site's Lanelet2 map. INTERACTION has these maps in `maps`.
    pub lanes: bool,
    /// The sensor that sees the evaluated part of ETH/UCY and INTERACTION. Training parts are seen without noise.
    pub noise: Noise,
    /// Threads that share the work; results do not depend on their number.
    pub threads: usize,
    /// Where all forecasts behind the tables are written.
    pub lines: Option<Arc<ForecastLines>>,
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
    fn read(&self, path: &Path, open: OpenOptions) -> Result<Footage, EvaluateError> {
        let recording = data::open_with(path, open)?;
        let scenes = self.scenes(&recording);
        Ok(Footage { recording, scenes })
    }
}

impl Options {
    /// The rules of a protocol.
    fn rules<'a>(
        &'a self,
        horizons: &'a [usize],
        subsets: &'a [Subset],
        of_type: Option<scene::AgentType>,
    ) -> Rules<'a> {
        Rules { horizons, subsets, of_type, threads: self.threads, lines: self.lines.as_deref() }
    }

    /// The lanes of a site of INTERACTION; `None` if the options do not use lanes.
    fn lanes_of(&self, site: &str) -> Result<Option<Arc<LaneMap>>, EvaluateError> {
        if !self.lanes {
            return Ok(None);
        }
        let path = self.data.join("interaction/maps").join(format!("{site}.osm"));
        Ok(Some(Arc::new(LaneMap::open(&path, Coordinates::default())?)))
    }

    /// Reads recordings and cuts them into scenes.
    fn read(&self, paths: &[PathBuf], open: &OpenOptions, cut: &Cut) -> Result<Vec<Footage>, EvaluateError> {
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

/// A protocol's counted agents and horizons.
#[derive(Clone, Copy)]
struct Rules<'a> {
    horizons: &'a [usize],
    subsets: &'a [Subset],
    of_type: Option<scene::AgentType>,
    threads: usize,
    lines: Option<&'a ForecastLines>,
}

impl Rules<'_> {
    /// Evaluates a recording; a recording without a counted agent is accepted.
    fn judge(
        &self,
        model: &Model,
        baselines: &Baselines,
        footage: &Footage,
        map: MapInput<'_>,
        part: &str,
    ) -> Vec<Block> {
        self.judge_with(model, baselines, part).recording(&footage.recording, &footage.scenes, map)
    }

    /// The evaluation of a model with these rules. `part` names the agents in the lines of forecasts.
    fn judge_with<'a>(&'a self, model: &'a Model, baselines: &'a Baselines, part: &str) -> Judge<'a> {
        Judge {
            forecaster: &model.forecaster,
            baselines,
            horizons: self.horizons,
            subsets: self.subsets,
            of_type: self.of_type,
            lanes: None,
            threads: self.threads,
            lines: self.lines.map(|lines| (lines, part.to_owned())),
        }
    }

    /// The horizons in seconds.
    fn horizons_s(&self, cut: &Cut) -> Vec<f64> {
        self.horizons.iter().map(|&steps| (steps as i64 * cut.step_ns()) as f64 / 1e9).collect()
    }

    /// Index of the longest horizon.
    const fn last(&self) -> usize {
        self.horizons.len() - 1
    }
}

fn fit(training: &[Footage], cut: &Cut) -> Baselines {
    Baselines::fit(training.iter().flat_map(|footage| &footage.scenes), cut, SEED)
}

/// Fails if the recordings have no counted agent.
fn need_agents(blocks: &[Block], name: &str, cut: &Cut) -> Result<(), EvaluateError> {
    if blocks.iter().any(|block| block.tallies.iter().any(|tally| !tally.is_empty())) {
        return Ok(());
    }
    let steps = cut.history_len + cut.horizon_len;
    Err(EvaluateError::NoWindows { name: name.to_owned(), steps, dt_s: cut.dt_s })
}

/// Caption of the tables of calibration and plausibility.
pub(crate) const RATES: &str = "KDE-NLL: negative log density of the truth under a kernel density of the 20 modes, weighted by their probabilities. Coverage: \
                     share of truths inside the highest-density region of the mixture of Gaussians, over agents and steps. Collision: the \
                     discs of two agents meet, 0.9 m around vehicles, 0.3 m around cyclists, 0.2 m around pedestrians. Limits are those of \
                     `metrics::Limits`, checked on all modes and K = 1.";

/// The rows of the tables of errors by horizon.
pub(crate) const GROWTH: [(crate::Measure, crate::Method); 5] = [
    (crate::Measure::BestOf, crate::Method::Network),
    (crate::Measure::BestOf, crate::Method::Base),
    (crate::Measure::BestOf, crate::Method::Anchors),
    (crate::Measure::Single, crate::Method::Network),
    (crate::Measure::Single, crate::Method::ConstantVelocity),
];
