//! The files that arguments name, checked before a run.

use std::path::{Path, PathBuf};

use configuration::options::absolute;
use console::failure::Failure;
use lanes::{Coordinates, LaneMap};
use localiser::MapChoice;
use nn::Weights;
use retrieval::RetrievalMemory;
use run::Run;
use sampler::LanesOrigin;
use scene::ContextMap;
use wire::{StageId, WorldOrigin};

use crate::files::{check_place, spooled};

/// Absolute path of a recording, or of the only one in a folder.
pub(super) fn recording_at(path: &Path) -> Result<PathBuf, Failure> {
    if let Some(path) = spooled(path)? {
        return Ok(path);
    }
    let path = canonical(path)?;
    if !path.is_dir() {
        return Ok(path);
    }
    let found = data::recordings_in(&path).map_err(Failure::data)?;
    match &found[..] {
        [] => Err(Failure::file(&path, "there is no recording in this folder")),
        [one] => Ok(one.clone()),
        [first, ..] => {
            let why = format!("{} recordings: name one, such as {}", found.len(), first.display());
            Err(Failure::file(&path, why))
        }
    }
}

/// Absolute path of an existing file.
pub fn canonical(path: &Path) -> Result<PathBuf, Failure> {
    path.canonicalize().map_err(|error| Failure::file(path, error))
}

/// Reads a lane map and warns about skipped elements.
///
/// # Errors
/// [`Failure::Data`] names the unusable map element.
pub fn open_lanes(path: &Path, coordinates: Coordinates) -> Result<LaneMap, Failure> {
    let map = LaneMap::open(path, coordinates).map_err(Failure::data)?;
    let skipped = map.skipped();
    skipped.warnings().for_each(|warning| tracing::warn!("{warning}"));
    let [nodes, ways, relations] = skipped.unneeded();
    tracing::info!(
        "{}: lanes {}; not needed: nodes {nodes}, ways {ways}, relations {relations}",
        path.display(),
        map.lanes().len()
    );
    Ok(map)
}

/// Checks before a run that its lane map can be read.
///
/// # Errors
/// As [`open_lanes`].
pub fn check_lanes(options: &sampler::Options, origin: WorldOrigin) -> Result<(), Failure> {
    let Some(path) = &options.lanes else { return Ok(()) };
    let coordinates = LanesOrigin::coordinates(options.lanes_origin, origin);
    open_lanes(&absolute(path)?, coordinates).map(|_| ())
}

/// Checks before a run that the priors of its experts can be read.
///
/// # Errors
/// [`Failure::Data`] names the file.
pub fn check_prior(options: &sampler::Options) -> Result<(), Failure> {
    let Some(path) = &options.prior else { return Ok(()) };
    evidence::Priors::open(&absolute(path)?).map(|_| ()).map_err(Failure::data)
}

/// The file of the fixed context map that the run's own localiser uses, if any.
pub fn map_path(run: &Run) -> Option<PathBuf> {
    let localiser = run.stage(StageId::Localiser).filter(|stage| stage.built_in)?;
    match toml::from_str::<localiser::Options>(&localiser.options).ok()?.map {
        MapChoice::File(path) => Some(path),
        MapChoice::Online | MapChoice::None => None,
    }
}

/// The fixed context map of a run, if it has one.
///
/// # Errors
/// [`Failure::Data`] if the map can't be read.
pub fn map_of(run: &Run) -> Result<Option<ContextMap>, Failure> {
    map_path(run).map(|path| ContextMap::load(&absolute(&path)?).map_err(Failure::data)).transpose()
}

/// The map of lanes that the run's own sampler uses, if any.
pub fn lanes_of(run: &Run) -> Result<Option<LaneMap>, Failure> {
    let sampler = run.stage(StageId::Sampler).filter(|stage| stage.built_in);
    let options = sampler.and_then(|stage| toml::from_str::<sampler::Options>(&stage.options).ok());
    let Some((path, origin)) = options.and_then(|of| Some((of.lanes?, of.lanes_origin))) else {
        return Ok(None);
    };
    open_lanes(&absolute(&path)?, LanesOrigin::coordinates(origin, run.origin())).map(Some)
}

/// Returns the initial number of retrieval memory entries of a sampler with these options. Without a memory
/// file, returns `None`.
///
/// # Errors
/// [`Failure::Data`] if the file is not a memory of these weights or its folder is not writable.
pub fn check_memory(options: &sampler::Options, weights: &Weights) -> Result<Option<u64>, Failure> {
    let Some(path) = &options.memory else { return Ok(None) };
    let path = absolute(path)?;
    let mut entry_count = 0;
    if path.try_exists().map_err(|error| Failure::file(&path, error))? {
        let config = weights.config();
        let steps = (config.horizon_len, config.step_ns());
        let memory = RetrievalMemory::load(&path, weights.sha256(), steps).map_err(Failure::data)?;
        entry_count = memory.entry_count();
    }
    check_place(&path)?;
    Ok(Some(entry_count as u64))
}
