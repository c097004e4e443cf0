//! Training and validation scenes: windows of recordings with the map patches that belong to them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use data::{Recording, Told, Window, WindowAgent, WindowOptions, sets::DataSet, sets::Part};
use half::f16;
use nn::ModelConfig;
use scene::{AgentType, ContextMap, MapBuilder, OnlineMap, PatchOptions, State};

use crate::TrainError;

/// An agent of a window.
#[derive(Clone, Debug)]
pub(crate) struct Agent {
    /// Identity in the recording.
    pub(crate) id: u64,
    pub(crate) agent_type: AgentType,
    /// `None` where unknown.
    pub(crate) length_m: Option<f32>,
    /// States at the history steps, oldest first.
    pub(crate) history: Vec<Option<State>>,
    /// States at the forecast steps, velocities and headings by backward differences.
    pub(crate) future: Vec<Option<State>>,
    /// Number of the map patch of every history and forecast step.
    pub(crate) patches: Vec<Option<usize>>,
    /// Whether the agent is held to its future: it has two newest states, and its future is known to the end.
    pub(crate) counts: bool,
}

impl Agent {
    /// Of motion, what the recording has told at every time so far stays, unless `from_positions` asks for differences.
    /// The rest is differences over the model's step: those over the frames of a fast recording would be mostly noise,
    /// which no tracker passes on.
    fn new(
        agent: &WindowAgent,
        patches: Vec<Option<usize>>,
        from_positions: bool,
        config: &ModelConfig,
    ) -> Self {
        let history_len = agent.history.len();
        let positions: Vec<Option<[f32; 2]>> = agent
            .history
            .iter()
            .map(|state| state.map(|state| state.position_m))
            .chain(agent.future.iter().copied())
            .collect();
        let mut states = vec![None; positions.len()];
        scene::states_from_positions(&positions, history_len, config.dt_s as f32, &mut states);
        let future = states.split_off(history_len);
        let Told { agent_type, length_m, has_speed, has_heading, .. } = agent.told;
        let [keeps_velocity, keeps_heading] = [has_speed, has_heading].map(|has| has && !from_positions);
        let choose = |recorded: State, differenced: State| State {
            position_m: recorded.position_m,
            velocity_mps: if keeps_velocity { recorded.velocity_mps } else { differenced.velocity_mps },
            heading_rad: if keeps_heading { recorded.heading_rad } else { differenced.heading_rad },
        };
        let history: Vec<Option<State>> = agent
            .history
            .iter()
            .zip(states)
            .map(|(recorded, differenced)| Some(choose((*recorded)?, differenced?)))
            .collect();
        let newest_two = history_len >= 2 && history.iter().rev().take(2).all(Option::is_some);
        Self {
            id: agent.id,
            agent_type,
            length_m: (length_m > 0.0).then_some(length_m),
            history,
            future,
            patches,
            counts: newest_two && agent.future.iter().all(Option::is_some),
        }
    }

    /// The history with all but the newest `len` steps absent.
    pub(crate) fn history_of(&self, len: usize) -> Vec<Option<State>> {
        let hidden = self.history.len().saturating_sub(len);
        self.history.iter().enumerate().map(|(step, state)| state.filter(|_| step >= hidden)).collect()
    }

    /// Recorded positions of the forecast steps.
    pub(crate) fn future_m(&self) -> Vec<Option<[f32; 2]>> {
        self.future.iter().map(|state| state.map(|state| state.position_m)).collect()
    }
}

/// A window.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    /// Number of the recording it is of.
    pub(crate) recording: usize,
    pub(crate) agents: Vec<Agent>,
}

impl Scene {
    /// Whether any agent is held to its future.
    fn counts(&self) -> bool {
        self.agents.iter().any(|agent| agent.counts)
    }
}

/// The map patches of a recording.
#[derive(Clone, Debug)]
pub(crate) struct Patches {
    /// State of the agent that each patch is of.
    states: Vec<State>,
    /// What was observed before the patch's time, patch by patch.
    online: Vec<f16>,
    /// What the site's other training recordings observed.
    site: Option<ContextMap>,
}

/// Which map a scene is shown with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MapKind {
    /// What was observed before the present.
    Online,
    /// What other recordings of the site observed.
    Site,
}

/// The patches of a recording, of one kind of map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MapView<'a> {
    /// Number of the recording.
    pub(crate) recording: usize,
    patches: &'a Patches,
    kind: MapKind,
}

impl Patches {
    /// The patches as those of a recording with this number; `None` where there is no such map.
    pub(crate) fn view(&self, recording: usize, kind: MapKind) -> Option<MapView<'_>> {
        let known = match kind {
            MapKind::Online => !self.online.is_empty(),
            MapKind::Site => self.site.is_some(),
        };
        known.then_some(MapView { recording, patches: self, kind })
    }
}

impl MapView<'_> {
    /// Appends the values of a patch.
    pub(crate) fn extend(&self, patch: usize, options: PatchOptions, values: &mut Vec<f32>) {
        let start = values.len();
        match (self.kind, &self.patches.site) {
            (MapKind::Site, Some(site)) => {
                values.resize(start + options.len(), 0.0);
                site.patch(&self.patches.states[patch], options, &mut values[start..]);
            }
            _ => {
                let stored = &self.patches.online[patch * options.len()..][..options.len()];
                values.extend(stored.iter().map(|value| value.to_f32()));
            }
        }
    }
}

/// A recording that samples were taken of.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Source {
    /// Data set and part.
    pub set: String,
    /// Name of the recording.
    pub name: String,
    /// SHA-256 of its files.
    pub sha256: String,
}

/// The scenes of one data set and part.
#[derive(Clone, Debug)]
pub(crate) struct SetSamples {
    pub(crate) set: DataSet,
    pub(crate) scenes: Vec<Scene>,
}

/// All scenes in memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    pub(crate) sets: Vec<SetSamples>,
    pub(crate) sources: Vec<Source>,
    patches: Vec<Patches>,
    /// Site of every recording, where its set has several of one.
    sites: Vec<Option<PathBuf>>,
}

impl SetSamples {
    /// All agents that are held to their future.
    pub(crate) fn counted(&self) -> impl Iterator<Item = &Agent> + Clone {
        self.scenes.iter().flat_map(|scene| &scene.agents).filter(|agent| agent.counts)
    }
}

/// Which scenes to read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Selection<'a> {
    /// Folder that holds the data sets.
    pub(crate) root: &'a Path,
    pub(crate) sets: &'a [DataSet],
    pub(crate) part: Part,
    /// Recordings whose path holds one of these are left out.
    pub(crate) leave_out: &'a [String],
    /// Windows of each set, at most; they are spread evenly.
    pub(crate) windows_max: usize,
    /// Whether velocities and headings come from the positions even where the recording has its own.
    pub(crate) from_positions: bool,
    /// Whether only agents with a whole history count.
    pub(crate) whole_history: bool,
}

impl Selection<'_> {
    fn files(&self, set: DataSet) -> Result<Vec<PathBuf>, TrainError> {
        let mut files = set.files(self.root, self.part)?;
        files.retain(|path| {
            let path = path.to_string_lossy();
            !self.leave_out.iter().any(|name| path.contains(name.as_str()))
        });
        Ok(files)
    }
}

impl Samples {
    /// Reads scenes; `progress` is told the path of each file before it is read.
    pub(crate) fn read(
        selection: Selection<'_>,
        config: &ModelConfig,
        mut progress: impl FnMut(&Path),
    ) -> Result<Self, TrainError> {
        let mut samples = Self::default();
        for &set in selection.sets {
            let mut scenes = Vec::new();
            for path in selection.files(set)? {
                progress(&path);
                let recording = data::open(&path, Some(set.format()))?;
                let number = samples.sources.len();
                let (of_recording, patches) = cut(&recording, number, selection, config);
                scenes.extend(of_recording.into_iter().filter(Scene::counts));
                samples.patches.push(patches);
                samples.sites.push(site(set, &path));
                samples.sources.push(Source {
                    set: format!("{} {}", set.name(), selection.part.name()),
                    name: recording.name,
                    sha256: recording.sha256,
                });
            }
            let stride = scenes.len().div_ceil(selection.windows_max).max(1);
            let scenes = scenes.into_iter().step_by(stride).collect();
            samples.sets.push(SetSamples { set, scenes });
        }
        Ok(samples)
    }

    /// Gives every recording the map of what the *other* recordings of `training` saw of its site.
    pub(crate) fn add_site_maps(&mut self, training: Option<&Self>) {
        let maps: Vec<Option<ContextMap>> = (0..self.patches.len())
            .map(|number| {
                let site = self.sites[number].as_ref()?;
                let from = training.unwrap_or(self);
                let others = (0..from.patches.len()).filter(|&other| {
                    from.sites[other].as_ref() == Some(site)
                        && from.sources[other].sha256 != self.sources[number].sha256
                });
                site_map(others.flat_map(|other| &from.patches[other].states))
            })
            .collect();
        self.patches.iter_mut().zip(maps).for_each(|(patches, map)| patches.site = map);
    }

    /// The patches that scenes of a recording are shown with; `None` where there is no such map.
    pub(crate) fn map(&self, recording: usize, kind: MapKind) -> Option<MapView<'_>> {
        self.patches[recording].view(recording, kind)
    }

    /// All agents that are held to their future.
    pub(crate) fn counted(&self) -> impl Iterator<Item = &Agent> + Clone {
        self.sets.iter().flat_map(SetSamples::counted)
    }
}

/// The folder of a recording is its site, in data sets that have several recordings of one.
fn site(set: DataSet, path: &Path) -> Option<PathBuf> {
    (set == DataSet::Interaction).then(|| path.parent().map(Path::to_owned))?
}

/// The map of all places where agents were seen; `None` where nothing was seen, or over more ground than a map has.
fn site_map<'a>(states: impl Iterator<Item = &'a State> + Clone) -> Option<ContextMap> {
    let corner = |pick: fn(f32, f32) -> f32, from: f32| {
        states
            .clone()
            .fold([from; 2], |corner, state| [0, 1].map(|axis| pick(corner[axis], state.position_m[axis])))
    };
    let (low, high) = (corner(f32::min, f32::INFINITY), corner(f32::max, f32::NEG_INFINITY));
    let origin_m = low.map(f32::floor);
    let [cols, rows] = [0, 1].map(|axis| (high[axis] - origin_m[axis]) as usize + 1);
    let mut builder = MapBuilder::new(origin_m, rows, cols)?;
    let visits = states.filter(|state| builder.visit(state.position_m, state.velocity_mps)).count();
    (visits > 0).then(|| builder.build())
}

/// Scenes and patches of a recording, a scene for each of its windows.
pub(crate) fn cut(
    recording: &Recording,
    number: usize,
    selection: Selection<'_>,
    config: &ModelConfig,
) -> (Vec<Scene>, Patches) {
    let Selection { from_positions, whole_history, .. } = selection;
    let step_ns = config.step_ns() as i64;
    let options = WindowOptions {
        from_positions,
        ..WindowOptions::new(config.history_len, config.horizon_len, step_ns)
    };
    let windows = data::windows(recording, &options);
    let (patches, numbers) = cut_patches(recording, &windows, config);
    let scene = |window: &Window| {
        let agents = window.agents.iter().map(|agent| {
            let steps = (config.history_len + config.horizon_len) as i64;
            let first_ns = window.stamp_ns - (config.history_len as i64 - 1) * step_ns;
            let stamps = (0..steps).map(|step| first_ns + step * step_ns);
            let patches = stamps.map(|stamp_ns| numbers.get(&(agent.id, stamp_ns)).copied()).collect();
            let mut agent = Agent::new(agent, patches, from_positions, config);
            agent.counts &= !whole_history || agent.history.iter().all(Option::is_some);
            agent
        });
        Scene { recording: number, agents: agents.collect() }
    };
    (windows.iter().map(scene).collect(), patches)
}

/// The patches of every agent and window, and their numbers by (identity, stamp).
fn cut_patches(
    recording: &Recording,
    windows: &[Window],
    config: &ModelConfig,
) -> (Patches, BTreeMap<(u64, i64), usize>) {
    let options = PatchOptions { side: config.patch_size, cell_m: config.patch_cell_m };
    let mut patches = Patches { states: Vec::new(), online: Vec::new(), site: None };
    let mut numbers = BTreeMap::new();
    if !config.context {
        return (patches, numbers);
    }
    let egos: BTreeMap<i64, [f32; 2]> =
        recording.frames.iter().map(|frame| (frame.stamp_ns, frame.ego.position_m)).collect();
    let mut map = OnlineMap::new();
    let mut patch = vec![0.0; options.len()];
    for window in windows {
        let newest = || window.agents.iter().filter_map(|agent| Some((agent, (*agent.history.last()?)?)));
        for (agent, state) in newest() {
            map.patch(&state, options, &mut patch);
            numbers.insert((agent.id, window.stamp_ns), numbers.len());
            patches.states.push(state);
            patches.online.extend(patch.iter().map(|&value| f16::from_f32(value)));
        }
        let ego_m = egos.get(&window.stamp_ns).copied().unwrap_or_default();
        map.observe(ego_m, newest().map(|(_, state)| (state.position_m, state.velocity_mps)));
    }
    (patches, numbers)
}
