//! Training and validation scenes: windows of recordings with their map patches.
//!
//! **In:** the recordings of some data sets, for one part. **Out:** for each window, the states of its agents
//! at T_h history and T_f forecast steps (m, m/s, rad, world frame). Also the map patch `[3, P, P]` of every
//! agent and frame.
//!
//! Scenes are kept in a [spool](crate::spool). Memory holds only their offsets and the numbers of counted
//! agents. A recording is in memory only while it is cut. A batch reads the scenes and patches that it shows.
//! Passes over all data read one scene after the other.

mod agents;
mod cut;
mod ground;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use data::Recording;
use data::sets::{DataSet, Part};
use nn::ModelConfig;
use scene::{AgentType, ContextMap};

use crate::spool::{Spool, Spooling};
use crate::{TrainError, own};
pub(crate) use agents::{Agent, Scene, Window};
pub(crate) use cut::cut;
use ground::site_map;
pub(crate) use ground::{Ground, MapKind, MapView};

/// A recording of the training data.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Source {
    /// Data set and part.
    pub set: String,
    /// Name of the recording.
    pub name: String,
    /// SHA-256 of its files.
    pub sha256: String,
}

/// The windows of one data set and part.
#[derive(Clone, Debug)]
pub(crate) struct SetSamples {
    pub(crate) set: DataSet,
    pub(crate) windows: Vec<Window>,
    /// The windows of each site; all windows together if the set has no sites.
    pub(crate) sites: Vec<Range<usize>>,
}

impl SetSamples {
    /// Agents with a target.
    pub(crate) fn counted_count(&self) -> usize {
        self.windows.iter().map(Window::counted_count).sum()
    }
}

/// All windows, and the spool of their scenes.
#[derive(Debug)]
pub(crate) struct Samples {
    pub(crate) sets: Vec<SetSamples>,
    pub(crate) sources: Vec<Source>,
    spool: Spool,
    /// Steps of history and future.
    steps: [usize; 2],
    /// The ground of each recording.
    grounds: Vec<Ground>,
    /// Site of every recording, if its set has several recordings per site.
    sites: Vec<Option<PathBuf>>,
}

/// The folder of a recording in sets that are drawn evenly by site or source.
fn folder(set: DataSet, path: &Path) -> Option<PathBuf> {
    matches!(set, DataSet::Interaction | DataSet::Driving | DataSet::Ngsim)
        .then(|| path.parent().map(Path::to_owned))?
}

/// The scenes to read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Selection<'a> {
    /// Folder that holds the data sets.
    pub(crate) root: &'a Path,
    pub(crate) sets: &'a [DataSet],
    /// The files of [`DataSet::Own`].
    pub(crate) own: &'a [PathBuf],
    pub(crate) part: Part,
    /// Recordings whose path contains one of these are left out.
    pub(crate) leave_out: &'a [String],
    /// Maximum number of windows per set, spread evenly.
    pub(crate) windows_max: usize,
    /// Whether velocities and headings come from positions even if the recording has its own.
    pub(crate) from_positions: bool,
    /// Whether only agents with a whole history count.
    pub(crate) whole_history: bool,
}

#[cfg(test)]
impl<'a> Selection<'a> {
    /// The training part of some sets in a folder, all of it.
    pub(crate) const fn of_tests(root: &'a Path, sets: &'a [DataSet]) -> Self {
        Self {
            root,
            sets,
            own: &[],
            part: Part::Train,
            leave_out: &[],
            windows_max: usize::MAX,
            from_positions: false,
            whole_history: false,
        }
    }
}

impl Selection<'_> {
    fn files(&self, set: DataSet) -> Result<Vec<PathBuf>, TrainError> {
        let mut files = match set {
            DataSet::Own => own::files_of(self.own, self.part).to_vec(),
            _ => set.files(self.root, self.part)?,
        };
        files.retain(|path| {
            let path = path.to_string_lossy();
            !self.leave_out.iter().any(|name| path.contains(name.as_str()))
        });
        Ok(files)
    }
}

impl Samples {
    /// Reads recordings one after the other into the spool. Calls `progress` with the path of each file
    /// before it is read.
    pub(crate) fn read(
        selection: Selection<'_>,
        config: &ModelConfig,
        spooling: Spooling,
        mut progress: impl FnMut(&Path),
    ) -> Result<Self, TrainError> {
        let mut cutting = Cutting::new(selection, config, spooling);
        for &set in selection.sets {
            for path in selection.files(set)? {
                progress(&path);
                let mut recording = set.open(&path)?;
                if set == DataSet::Own {
                    recording = own::within(recording, selection.own, selection.part);
                }
                cutting.push(set, &path, &recording)?;
            }
            cutting.end_set(set);
        }
        cutting.finish()
    }

    /// The samples of a user's own recordings.
    pub(crate) fn of(
        recordings: &[&Recording],
        selection: Selection<'_>,
        config: &ModelConfig,
        spooling: Spooling,
    ) -> Result<Self, TrainError> {
        let mut cutting = Cutting::new(selection, config, spooling);
        for recording in recordings {
            cutting.push(DataSet::Own, Path::new(""), recording)?;
        }
        cutting.end_set(DataSet::Own);
        cutting.finish()
    }

    /// Gives every recording the site map of the *other* recordings of `training`.
    pub(crate) fn add_site_maps(&mut self, training: Option<&Self>) -> Result<(), TrainError> {
        let maps = (0..self.grounds.len()).map(|number| self.site_map(number, training.unwrap_or(self)));
        let maps: Vec<Option<ContextMap>> = maps.collect::<Result<_, _>>()?;
        self.grounds.iter_mut().zip(maps).for_each(|(ground, map)| ground.set_site(map));
        Ok(())
    }

    fn site_map(&self, number: usize, from: &Self) -> Result<Option<ContextMap>, TrainError> {
        let Some(site) = &self.sites[number] else { return Ok(None) };
        let is_other = |other: &usize| {
            from.sites[*other].as_ref() == Some(site)
                && from.sources[*other].sha256 != self.sources[number].sha256
        };
        let others: Vec<&Ground> =
            (0..from.grounds.len()).filter(is_other).map(|other| &from.grounds[other]).collect();
        site_map(&from.spool, &others)
    }

    /// The patches of a recording by one kind of map; `None` if there is no such map.
    pub(crate) fn map(&self, recording: u32, kind: MapKind) -> Option<MapView<'_>> {
        self.grounds[recording as usize].view(&self.spool, recording, kind)
    }

    /// Reads the scene of a window.
    pub(crate) fn scene(&self, window: &Window) -> Result<Scene, TrainError> {
        Scene::read(&self.spool, window, self.steps)
    }

    /// Reads agents of a type in `sets` that have a target: at most `len_max`, spread evenly. Scenes without
    /// such agents are not read.
    pub(crate) fn spread<'a>(
        &'a self,
        sets: &'a [SetSamples],
        agent_type: AgentType,
        len_max: usize,
    ) -> impl Iterator<Item = Result<Arc<Agent>, TrainError>> + 'a {
        let of_type = move |window: &Window| window.counted[agent_type.index()] as usize;
        let windows = || sets.iter().flat_map(|set| &set.windows);
        let stride = windows().map(of_type).sum::<usize>().div_ceil(len_max).max(1);
        let mut passed = 0_usize;
        windows().flat_map(move |window| {
            let first = passed.next_multiple_of(stride) - passed;
            passed += of_type(window);
            if first >= of_type(window) {
                return Vec::new();
            }
            let agents = match self.scene(window) {
                Ok(scene) => scene.agents,
                Err(error) => return vec![Err(error)],
            };
            let counted = agents.into_iter().filter(|agent| agent.agent_type == agent_type && agent.counts);
            counted.skip(first).step_by(stride).map(Ok).collect()
        })
    }
}

/// Samples while recordings are cut.
struct Cutting<'a> {
    selection: Selection<'a>,
    config: &'a ModelConfig,
    spooling: Spooling,
    sets: Vec<SetSamples>,
    sources: Vec<Source>,
    grounds: Vec<Ground>,
    sites: Vec<Option<PathBuf>>,
    folders: Vec<Option<PathBuf>>,
    /// The windows of the present set.
    windows: Vec<Window>,
}

impl<'a> Cutting<'a> {
    fn new(selection: Selection<'a>, config: &'a ModelConfig, spooling: Spooling) -> Self {
        Self {
            selection,
            config,
            spooling,
            sets: Vec::new(),
            sources: Vec::new(),
            grounds: Vec::new(),
            sites: Vec::new(),
            folders: Vec::new(),
            windows: Vec::new(),
        }
    }

    fn push(&mut self, set: DataSet, path: &Path, recording: &Recording) -> Result<(), TrainError> {
        let number = self.sources.len() as u32;
        let (scenes, ground) = cut(recording, self.selection, self.config, &mut self.spooling)?;
        for scene in scenes.filter(|scene| scene.agents.iter().any(|agent| agent.counts)) {
            self.windows.push(scene.append_to(&mut self.spooling, number)?);
        }
        self.grounds.push(ground);
        self.sites.push(site(set, path));
        self.folders.push(folder(set, path));
        self.sources.push(Source {
            set: format!("{} {}", set.name(), self.selection.part.name()),
            name: recording.name.clone(),
            sha256: recording.sha256.clone(),
        });
        Ok(())
    }

    fn end_set(&mut self, set: DataSet) {
        let windows = std::mem::take(&mut self.windows);
        let stride = windows.len().div_ceil(self.selection.windows_max).max(1);
        let windows: Vec<Window> = windows.into_iter().step_by(stride).collect();
        let of_window = |window: &Window| self.folders[window.recording as usize].as_deref();
        let sites = runs(&windows, |a, b| of_window(a) == of_window(b));
        self.sets.push(SetSamples { set, windows, sites });
    }

    fn finish(self) -> Result<Samples, TrainError> {
        let Self { config, spooling, sets, sources, grounds, sites, .. } = self;
        let steps = [config.history_len, config.horizon_len];
        Ok(Samples { sets, sources, spool: spooling.finish()?, steps, grounds, sites })
    }
}

/// Ranges of consecutive values that belong together.
fn runs<T>(values: &[T], together: impl FnMut(&T, &T) -> bool) -> Vec<Range<usize>> {
    let mut end = 0;
    let run = |run: &[T]| {
        let start = end;
        end += run.len();
        start..end
    };
    values.chunk_by(together).map(run).collect()
}

/// The site of a recording, which is its folder in data sets with several recordings per site.
fn site(set: DataSet, path: &Path) -> Option<PathBuf> {
    (set == DataSet::Interaction).then(|| path.parent().map(Path::to_owned))?
}
