//! A model over whole recordings: what it says of every agent of every scene, and what memories of the place make of it.

use data::Recording;
use metrics::Point;
use retrieval::{Key, Query, RetrievalMemory, Retrieved};
use wire::{CONTEXT_EMBEDDING, HORIZON_MAX};

use crate::forecaster::{ForecasterMemory, Said};
use crate::maps::{ContextTable, MapInput};
use crate::{Forecaster, Scene, motion, threads};

/// Scenes that are forecast before the memory of the place goes on.
pub(crate) const TOGETHER: usize = 64;

/// A model, and the threads that share its scenes.
#[derive(Clone, Copy)]
pub(crate) struct Speaker<'a> {
    pub(crate) forecaster: &'a Forecaster,
    pub(crate) threads: usize,
}

/// An agent of a scene with what is said of it.
pub(crate) struct Spoken {
    /// Its place in the scene.
    pub(crate) place: usize,
    pub(crate) said: Said,
    /// The key under which it is stored, if any, and the single best forecast.
    entry: Option<(Key, Vec<Point>)>,
}

impl Speaker<'_> {
    /// A memory of nothing; none for a model that forecasts farther than the pipeline can carry: it recalls nothing.
    pub(crate) fn memory(&self) -> Option<RetrievalMemory> {
        let config = self.forecaster.config();
        (config.horizon_len <= HORIZON_MAX)
            .then(|| RetrievalMemory::new(config.horizon_len, config.step_ns()))
    }

    /// Lets a memory take in a recording, as the forecaster would have forecast it, and leave.
    pub(crate) fn visit(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        memory: &mut RetrievalMemory,
    ) {
        let table = ContextTable::new(self.forecaster, recording, scenes, map, self.threads);
        for scenes in scenes.chunks(TOGETHER) {
            for (scene, spoken) in scenes.iter().zip(self.spoken(scenes, &table)) {
                recall(Some(memory), scene, &spoken);
            }
        }
        memory.end_session();
    }

    /// What is said of all who are there, in the agents' order, whether they count or not: scene by scene.
    pub(crate) fn spoken(&self, scenes: &[Scene], table: &ContextTable) -> Vec<Vec<Spoken>> {
        let of_scene = |scene: &Scene, memory: &mut ForecasterMemory| {
            let present = |&agent: &usize| scene.agents[agent].newest().is_some();
            let wanted: Vec<usize> = (0..scene.agents.len()).filter(present).collect();
            let context = |agent: usize, step: usize| self.context(scene, table, (agent, step));
            let said = self.forecaster.say(scene, context, &wanted, memory);
            let spoken = |(place, said): (usize, Said)| {
                let agent = &scene.agents[place];
                let key = motion::key(agent, self.forecaster.config());
                let entry = key.map(|key| (key, self.forecaster.lead_best(agent, &said)));
                Spoken { place, said, entry }
            };
            wanted.into_iter().zip(said).map(spoken).collect()
        };
        threads::each(scenes, self.threads, of_scene)
    }

    fn context(
        &self,
        scene: &Scene,
        table: &ContextTable,
        (agent, step): (usize, usize),
    ) -> [f32; CONTEXT_EMBEDDING] {
        let config = self.forecaster.config();
        let back = (config.history_len - 1 - step) as i64;
        table.of(scene.agents[agent].id, scene.stamp_ns - back * config.step_ns() as i64)
    }
}

/// What is retrieved for the agents of a scene, in their order, all of which are then stored; nothing without a memory.
pub(crate) fn recall(
    memory: Option<&mut RetrievalMemory>,
    scene: &Scene,
    spoken: &[Spoken],
) -> Vec<Option<Retrieved>> {
    let Some(memory) = memory else { return vec![None; spoken.len()] };
    let present = scene.agents.iter().filter_map(|agent| Some((agent.id, agent.newest()?.position_m)));
    memory.observe(scene.stamp_ns, present);
    let of_agent = |Spoken { place, entry, .. }: &Spoken| {
        let mut retrieved = Retrieved::default();
        if let Some((key, forecast)) = entry {
            let query = Query { stamp_ns: scene.stamp_ns, agent: scene.agents[*place].id, key: *key };
            memory.retrieve_and_store(&query, forecast, &mut retrieved);
        }
        Some(retrieved)
    };
    spoken.iter().map(of_agent).collect()
}
