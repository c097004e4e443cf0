//! Sources: folders of recordings of similar roads.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use data::Recording;
use evidence::{Prior, Priors};
use metrics::Anchors;
use nn::ModelConfig;
use onboard::Chain;
use run::{Run, StageRun};
use scene::AgentType;

use crate::error::EvaluateError;
use crate::footage::{MapChoice, Options, SEED};
use crate::playback::Playing;
use crate::scenes::{Agent, Cut};
use crate::windows;

/// Sources with fast roads, which are also played at twice their scale.
const FAST: [&str; 2] = ["ngsim_us101", "mona"];
/// Bounds of the speed bins of vehicles' anchors; they include motorway speeds.
const SPEED_CUTS_MPS: [f32; metrics::SPEED_BINS - 1] = [1.0, 3.5, 6.5, 10.0, 14.5, 20.0, 28.0];
/// Maximum number of windows per source and type that anchors are fitted to.
const WINDOWS_MAX: usize = 4_000;

/// A folder of recordings, at original or changed scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Name in tables.
    pub name: String,
    /// The folder.
    pub folder: PathBuf,
    /// The recordings, sorted by name.
    pub files: Vec<PathBuf>,
    /// Factor on all distances; agents keep their sizes.
    pub scale: f32,
}

/// The sources in a folder, including fast sources at twice their scale. If `named` is not empty, only the
/// sources that it names.
///
/// # Errors
/// [`EvaluateError`] if the folder can't be listed or has no source of a given name.
pub fn sources(folder: &Path, named: &[String]) -> Result<Vec<Source>, EvaluateError> {
    let mut all = Vec::new();
    for folder in list(folder)?.into_iter().filter(|path| path.is_dir()) {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut files = list(&folder)?;
        files.retain(|path| path.extension().is_some_and(|extension| extension == "csv"));
        let fast = FAST.contains(&&*name);
        let twice = || Source {
            name: format!("{name} ×2"),
            folder: folder.clone(),
            files: files.clone(),
            scale: 2.0,
        };
        all.extend(fast.then(twice));
        all.push(Source { name, folder, files, scale: 1.0 });
    }
    all.sort_by(|a, b| {
        (a.scale, &a.name).partial_cmp(&(b.scale, &b.name)).unwrap_or(std::cmp::Ordering::Equal)
    });
    if named.is_empty() {
        return Ok(all);
    }
    let known: Vec<&str> = all.iter().map(|source| &*source.name).collect();
    if let Some(name) = named.iter().find(|name| !known.contains(&&***name)) {
        return Err(EvaluateError::UnknownSource { name: name.clone(), known: known.join(", ") });
    }
    all.retain(|source| named.contains(&source.name));
    Ok(all)
}

fn list(folder: &Path) -> Result<Vec<PathBuf>, EvaluateError> {
    let failed = |source: std::io::Error| EvaluateError::unusable(folder.display().to_string(), source);
    let entries = std::fs::read_dir(folder).map_err(failed)?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    paths.sort();
    Ok(paths)
}

impl Source {
    /// Name of the folder, the same at any scale.
    pub(crate) fn folder_name(&self) -> String {
        self.folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Opens a recording at the source's scale.
    pub(crate) fn open(&self, path: &Path) -> Result<Recording, EvaluateError> {
        let mut recording = data::open(path, None)?;
        if self.scale != 1.0 {
            for frame in &mut recording.frames {
                frame.ego.position_m = frame.ego.position_m.map(|x| self.scale * x);
                for detection in &mut frame.detections {
                    let lengths = [&mut detection.x_m, &mut detection.y_m, &mut detection.speed_mps];
                    lengths.into_iter().for_each(|length| *length *= self.scale);
                }
            }
        }
        Ok(recording)
    }

    /// The map of a recording's lanes, if there is one. At another scale there is none.
    pub(crate) fn lanes_of(&self, path: &Path, options: &Options) -> Option<PathBuf> {
        let is_along = options.lanes && self.scale == 1.0;
        let folder = is_along.then(|| options.data.join("driving_maps"))?;
        let map = folder.join(self.folder_name()).join(path.file_stem()?).with_added_extension("osm");
        map.exists().then_some(map)
    }

    /// Plays the recordings as one run: each has new tracks, a new map and a new retrieval memory, and the sampler
    /// keeps its evidence. `each` gets the number, the file and the playback of a recording, and plays it. Returns
    /// the stages after the last recording.
    pub(crate) fn play(
        &self,
        options: &Options,
        model: &ModelConfig,
        mut each: impl FnMut(usize, &Path, &mut Playing) -> Result<(), EvaluateError>,
    ) -> Result<Option<Chain>, EvaluateError> {
        let mut before: Option<Chain> = None;
        for (number, path) in self.files.iter().enumerate() {
            let recording = self.open(path)?;
            let mut playing = Playing::new(&recording, &options.noise, |interval_ns| {
                let run = run(interval_ns, options, self.lanes_of(path, options))?;
                Ok::<_, EvaluateError>(Chain::new(&run, model)?)
            })?;
            match before.take() {
                Some(before) => playing.chain.continue_from(before),
                None if options.priors => {
                    playing.chain.expect(Priors::shipped().without(&self.folder_name()));
                }
                None => playing.chain.expect(Prior::default()),
            }
            each(number, path, &mut playing)?;
            before = Some(playing.chain);
        }
        Ok(before)
    }

    /// Complete agents of the source's windows, at most [`WINDOWS_MAX`] per type, spread evenly.
    pub(crate) fn windows(&self, model: &ModelConfig) -> Result<Vec<Agent>, EvaluateError> {
        let mut of_type: BTreeMap<AgentType, Vec<Agent>> = BTreeMap::new();
        for path in &self.files {
            for scene in Cut::of(model).scenes(&self.open(path)?) {
                for agent in scene.agents.into_iter().filter(Agent::is_complete) {
                    of_type.entry(agent.agent_type).or_default().push(agent);
                }
            }
        }
        let few = |agents: Vec<Agent>| {
            let stride = agents.len().div_ceil(WINDOWS_MAX).max(1);
            agents.into_iter().step_by(stride)
        };
        Ok(of_type.into_values().flat_map(few).collect())
    }
}

/// Fits anchors to windows of sources. The speed bins of vehicles include motorway speeds.
pub(crate) fn anchors<'a>(
    sources: impl Iterator<Item = &'a [Agent]>,
    model: &ModelConfig,
) -> BTreeMap<AgentType, Anchors> {
    let cuts_mps = |agent_type| match agent_type {
        AgentType::Vehicle => SPEED_CUTS_MPS,
        _ => metrics::speed_cuts_mps(agent_type),
    };
    windows::anchors(sources.flatten(), model.dt_s as f32, model.horizon_len, cuts_mps, SEED)
}

/// The run of detections that are `interval_ns` apart, along the lanes of a map, if there is one.
pub(crate) fn run(interval_ns: u64, options: &Options, lanes: Option<PathBuf>) -> Result<Run, EvaluateError> {
    let sampler = sampler::Options { evidence: options.evidence, lanes, ..sampler::Options::default() };
    let decoder = decoder::Options { precision: options.weights.precision, ..decoder::Options::default() };
    let map = if options.map == MapChoice::None {
        localiser::MapChoice::None
    } else {
        localiser::MapChoice::Online
    };
    Ok(Run {
        interval_ns,
        lockstep: true,
        weights: options.weights.file.clone(),
        stages: vec![
            StageRun::with_options(&sampler::STAGE, &sampler)?,
            StageRun::with_options(&decoder::STAGE, &decoder)?,
            StageRun::with_options(&localiser::STAGE, &localiser::Options { map })?,
        ],
        ..Run::default()
    })
}
