//! What the network is told of the ground: context embeddings of every agent and time of a recording.

use std::collections::BTreeMap;

use data::Recording;
use scene::{ContextMap, MapBuilder, OnlineMap, State};
use wire::CONTEXT_EMBEDDING;

use crate::{Forecaster, Scene, threads};

/// Patches that are cut before the network embeds them: bounds the memory.
const CHUNK: usize = 2048;
/// Patches that a thread embeds in one go.
const BATCH: usize = 128;

/// Where local map patches are cut from.
#[derive(Clone, Copy, Debug)]
pub enum MapInput<'a> {
    /// Nowhere: every patch is empty.
    None,
    /// The map of what the recording showed before the patch's own time.
    Online,
    /// The map of a site, made of other recordings.
    Site(&'a ContextMap),
}

/// The context embeddings of a recording's agents.
pub(crate) struct ContextTable {
    embeddings: Vec<[f32; CONTEXT_EMBEDDING]>,
    numbers: BTreeMap<(u64, i64), usize>,
    /// That of the empty patch.
    empty: [f32; CONTEXT_EMBEDDING],
}

impl ContextTable {
    /// Embeds the patch of every agent at the time of every scene, once, whatever windows it is part of later.
    pub(crate) fn new(
        forecaster: &Forecaster,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        threads: usize,
    ) -> Self {
        let mut table =
            Self { embeddings: Vec::new(), numbers: BTreeMap::new(), empty: [0.0; CONTEXT_EMBEDDING] };
        let Some(options) = forecaster.patch_options() else { return table };
        let embed = |patches: &[f32]| {
            let batches: Vec<&[f32]> = patches.chunks(BATCH * options.len()).collect();
            threads::each(&batches, threads, |patches, _: &mut ()| forecaster.embed_patches(patches)).concat()
        };
        table.empty = embed(&vec![0.0; options.len()])[0];
        if matches!(map, MapInput::None) {
            return table;
        }
        let egos: BTreeMap<i64, [f32; 2]> =
            recording.frames.iter().map(|frame| (frame.stamp_ns, frame.ego.position_m)).collect();
        let mut online = OnlineMap::new();
        let (mut patch, mut patches) = (vec![0.0; options.len()], Vec::new());
        for scene in scenes {
            for (id, state) in newest(scene) {
                match map {
                    MapInput::Site(site) => site.patch(&state, options, &mut patch),
                    _ => online.patch(&state, options, &mut patch),
                }
                table.numbers.insert((id, scene.stamp_ns), table.numbers.len());
                patches.extend_from_slice(&patch);
            }
            let ego_m = egos.get(&scene.stamp_ns).copied().unwrap_or_default();
            online.observe(ego_m, newest(scene).map(|(_, state)| (state.position_m, state.velocity_mps)));
            if patches.len() >= CHUNK * options.len() {
                table.embeddings.extend(embed(&patches));
                patches.clear();
            }
        }
        table.embeddings.extend(embed(&patches));
        table
    }

    /// The embedding of an agent's patch at a time; that of the empty patch where no scene stood at that time.
    pub(crate) fn of(&self, id: u64, stamp_ns: i64) -> [f32; CONTEXT_EMBEDDING] {
        self.numbers.get(&(id, stamp_ns)).map_or(self.empty, |&number| self.embeddings[number])
    }
}

/// The map of all places where the scenes' agents were, a visit per step; `None` where they span more than a map holds.
#[must_use]
pub fn site_map<'a>(scenes: impl IntoIterator<Item = &'a Scene>) -> Option<ContextMap> {
    let states: Vec<State> = scenes.into_iter().flat_map(newest).map(|(_, state)| state).collect();
    let first = states.first()?.position_m;
    let (low, high) = states.iter().fold((first, first), |(low, high), state| {
        let extreme = |of: [f32; 2], pick: fn(f32, f32) -> f32| {
            [0, 1].map(|axis| pick(of[axis], state.position_m[axis]))
        };
        (extreme(low, f32::min), extreme(high, f32::max))
    });
    let origin_m = low.map(f32::floor);
    let [cols, rows] = [0, 1].map(|axis| (high[axis] - origin_m[axis]) as usize + 1);
    let mut builder = MapBuilder::new(origin_m, rows, cols)?;
    for state in states {
        builder.visit(state.position_m, state.velocity_mps);
    }
    Some(builder.build())
}

/// Identity and newest state of every agent.
fn newest(scene: &Scene) -> impl Iterator<Item = (u64, State)> + '_ {
    scene.agents.iter().filter_map(|agent| Some((agent.id, agent.newest()?)))
}
