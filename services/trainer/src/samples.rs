//! Training and validation scenes: windows of recordings with the map patches that belong to them.

use std::collections::BTreeMap;
use std::path::Path;

use data::{Recording, Window, WindowAgent, WindowOptions, sets::DataSet, sets::Part};
use half::f16;
use nn::ModelConfig;
use scene::{AgentType, OnlineMap, PatchOptions, State};

use crate::TrainError;

/// An agent of a window.
#[derive(Clone, Debug)]
pub(crate) struct Agent {
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
    fn new(
        agent: &WindowAgent,
        patches: Vec<Option<usize>>,
        given: GivenMotion,
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
        let history: Vec<Option<State>> = agent
            .history
            .iter()
            .zip(states)
            .map(|(recorded, differenced)| Some(given.choose((*recorded)?, differenced?)))
            .collect();
        let newest_two = history_len >= 2 && history.iter().rev().take(2).all(Option::is_some);
        Self {
            agent_type: agent.agent_type,
            length_m: (agent.length_m > 0.0).then_some(agent.length_m),
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

/// Which parts of an agent's motion the recording tells. The others are differences over the model's step: those over
/// the frames of a fast recording would be mostly noise, which no tracker passes on.
#[derive(Clone, Copy)]
struct GivenMotion {
    velocity: bool,
    heading: bool,
}

impl GivenMotion {
    /// What all detections of the recording have.
    fn of(recording: &Recording) -> Self {
        let all = |flag: u32| {
            let mut detections = recording.frames.iter().flat_map(|frame| &frame.detections);
            detections.all(|detection| detection.has(flag))
        };
        Self {
            velocity: all(wire::detection_flags::HAS_SPEED),
            heading: all(wire::detection_flags::HAS_HEADING),
        }
    }

    fn choose(self, recorded: State, differenced: State) -> State {
        State {
            position_m: recorded.position_m,
            velocity_mps: if self.velocity { recorded.velocity_mps } else { differenced.velocity_mps },
            heading_rad: if self.heading { recorded.heading_rad } else { differenced.heading_rad },
        }
    }
}

/// A window.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    /// Which recording of [`Samples::recordings`] it is of.
    pub(crate) recording: usize,
    pub(crate) agents: Vec<Agent>,
}

/// The map patches of a recording, each cut from what was observed before its time.
#[derive(Clone, Debug)]
pub(crate) struct Patches {
    /// Number of the recording.
    pub(crate) recording: usize,
    patch_len: usize,
    values: Vec<f16>,
}

impl Patches {
    /// Appends the values of a patch.
    pub(crate) fn extend(&self, patch: usize, values: &mut Vec<f32>) {
        values.extend(
            self.values[patch * self.patch_len..][..self.patch_len].iter().map(|value| value.to_f32()),
        );
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
    pub(crate) patches: Vec<Patches>,
    pub(crate) sources: Vec<Source>,
}

impl SetSamples {
    /// All agents that are held to their future.
    pub(crate) fn counted(&self) -> impl Iterator<Item = &Agent> + Clone {
        self.scenes.iter().flat_map(|scene| &scene.agents).filter(|agent| agent.counts)
    }
}

impl Samples {
    /// Reads a part of the data sets below `root`, keeping at most `windows_max` evenly spread windows of each set.
    ///
    /// `progress` is told the path of each file before it is read.
    pub(crate) fn read(
        root: &Path,
        sets: &[DataSet],
        part: Part,
        windows_max: usize,
        config: &ModelConfig,
        mut progress: impl FnMut(&Path),
    ) -> Result<Self, TrainError> {
        let mut samples = Self::default();
        for &set in sets {
            let mut scenes = Vec::new();
            for path in set.files(root, part)? {
                progress(&path);
                let recording = data::open(&path, Some(set.format()))?;
                let number = samples.sources.len();
                let (mut of_recording, patches) = cut(&recording, number, config);
                scenes.append(&mut of_recording);
                samples.patches.push(patches);
                samples.sources.push(Source {
                    set: format!("{} {}", set.name(), part.name()),
                    name: recording.name,
                    sha256: recording.sha256,
                });
            }
            let stride = scenes.len().div_ceil(windows_max).max(1);
            let scenes = scenes.into_iter().step_by(stride).collect();
            samples.sets.push(SetSamples { set, scenes });
        }
        Ok(samples)
    }

    /// All agents that are held to their future.
    pub(crate) fn counted(&self) -> impl Iterator<Item = &Agent> + Clone {
        self.sets.iter().flat_map(SetSamples::counted)
    }
}

/// Scenes and patches of a recording.
fn cut(recording: &Recording, number: usize, config: &ModelConfig) -> (Vec<Scene>, Patches) {
    let step_ns = config.step_ns() as i64;
    let options = WindowOptions::new(config.history_len, config.horizon_len, step_ns);
    let windows = data::windows(recording, &options);
    let (patches, numbers) = cut_patches(recording, &windows, number, config);
    let given = GivenMotion::of(recording);
    let scene = |window: &Window| {
        let agents = window.agents.iter().map(|agent| {
            let steps = (config.history_len + config.horizon_len) as i64;
            let first_ns = window.stamp_ns - (config.history_len as i64 - 1) * step_ns;
            let stamps = (0..steps).map(|step| first_ns + step * step_ns);
            Agent::new(
                agent,
                stamps.map(|stamp_ns| numbers.get(&(agent.id, stamp_ns)).copied()).collect(),
                given,
                config,
            )
        });
        Scene { recording: number, agents: agents.collect() }
    };
    let scenes = windows.iter().map(scene).filter(|scene| scene.agents.iter().any(|agent| agent.counts));
    (scenes.collect(), patches)
}

/// The patches of every agent and window, and their numbers by (identity, stamp).
fn cut_patches(
    recording: &Recording,
    windows: &[Window],
    number: usize,
    config: &ModelConfig,
) -> (Patches, BTreeMap<(u64, i64), usize>) {
    let options = PatchOptions { side: config.patch_size, cell_m: config.patch_cell_m };
    let mut patches = Patches { recording: number, patch_len: options.len(), values: Vec::new() };
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
            patches.values.extend(patch.iter().map(|&value| f16::from_f32(value)));
        }
        let ego_m = egos.get(&window.stamp_ns).copied().unwrap_or_default();
        map.observe(ego_m, newest().map(|(_, state)| (state.position_m, state.velocity_mps)));
    }
    (patches, numbers)
}
