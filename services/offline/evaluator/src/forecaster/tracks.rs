//! `tracks` payloads of windows, as a tracker would publish them if it knew the recorded states exactly.

use std::collections::BTreeMap;

use data::Recording;
use scene::State;
use wire::{AGENTS_MAX, HISTORY_MAX, Header, HistoryState, Track, TrackStatus};

use crate::scenes::{Agent, Scene};

/// The `tracks` payload of a scene.
#[derive(Clone, Debug)]
pub struct TracksPayload {
    /// Header of the tick.
    pub header: Header,
    /// The agents that are present, as far as there is room.
    pub tracks: Vec<Track>,
    /// The place of each track among the scene's agents.
    pub places: Vec<usize>,
    /// Present agents for which the payload has no room.
    pub left_out: usize,
}

/// Publishes the scenes of a recording one after the other.
pub(crate) struct Publisher {
    header: Header,
    egos: BTreeMap<i64, [f32; 2]>,
    /// Agents' histories in the previous scene.
    before: BTreeMap<u64, Vec<Option<State>>>,
}

impl Publisher {
    /// Publishes scenes of a recording with headers like `header`.
    pub(crate) fn new(header: Header, recording: &Recording) -> Self {
        let egos = recording.frames.iter().map(|frame| (frame.stamp_ns, frame.ego.position_m));
        Self { header, egos: egos.collect(), before: BTreeMap::new() }
    }

    /// The next scene as a payload.
    ///
    /// The extractor caches its results for published states, because a tracker never changes them. Histories
    /// from positions alone do change: a scene can contain another version of a state than an earlier scene.
    /// Such a scene, or one that does not follow the previous scene, starts a new run.
    pub(crate) fn next(&mut self, scene: &Scene) -> TracksPayload {
        let step_ns = self.header.step_ns.cast_signed();
        let is_next = self.header.stamp_ns.checked_add(step_ns) == Some(scene.stamp_ns);
        let is_restated = |agent: &Agent| {
            let Some((_, past)) = agent.history.split_last() else { return false };
            match self.before.get(&agent.id) {
                Some(before) => before[1..] != *past,
                None => past.iter().any(Option::is_some),
            }
        };
        if !is_next || scene.agents.iter().any(is_restated) {
            self.header.run_id += 1;
        }
        self.before = scene.agents.iter().map(|agent| (agent.id, agent.history.clone())).collect();
        let ego_m = self.egos.get(&scene.stamp_ns).copied().unwrap_or_default();
        self.header = Header { seq: self.header.seq + 1, stamp_ns: scene.stamp_ns, ego_m, ..self.header };
        TracksPayload::of(scene, self.header)
    }
}

impl TracksPayload {
    /// The payload with all agents that are present, in the scene's order. Their recorded states count as
    /// certain, and the tracks as confirmed. As in a run, an agent is forecast if it was present at an
    /// earlier step.
    ///
    /// A payload has room for [`AGENTS_MAX`]. If more agents are present, complete agents come first, then
    /// the nearest to the scene's middle.
    pub fn of(scene: &Scene, header: Header) -> Self {
        let present = |&place: &usize| scene.agents[place].newest().is_some();
        let mut places: Vec<usize> = (0..scene.agents.len()).filter(present).collect();
        let left_out = places.len().saturating_sub(AGENTS_MAX);
        if left_out > 0 {
            keep_nearest(scene, &mut places);
        }
        let tracks: Vec<Track> = places.iter().filter_map(|&place| track(&scene.agents[place])).collect();
        let mut header = Header { stamp_ns: scene.stamp_ns, left_out_len: left_out as u32, ..header };
        header.counts.agents_len = tracks.len() as u32;
        Self { header, tracks, places, left_out }
    }
}

/// Reduces places to the number that a payload has room for.
fn keep_nearest(scene: &Scene, places: &mut Vec<usize>) {
    let position = |place: usize| scene.agents[place].newest().map_or([0.0; 2], |state| state.position_m);
    let middle = [0, 1].map(|axis| {
        let sum: f64 = places.iter().map(|&place| f64::from(position(place)[axis])).sum();
        (sum / places.len() as f64) as f32
    });
    let distance_m = |place: usize| (position(place)[0] - middle[0]).hypot(position(place)[1] - middle[1]);
    places.sort_by(|&a, &b| {
        let is_complete = |place: usize| scene.agents[place].is_complete();
        is_complete(b).cmp(&is_complete(a)).then(distance_m(a).total_cmp(&distance_m(b)))
    });
    places.truncate(AGENTS_MAX);
    places.sort_unstable();
}

/// An agent as a track; `None` if it is absent.
pub fn track(agent: &Agent) -> Option<Track> {
    let now = agent.newest()?;
    let state_count = agent.history.iter().flatten().count() as u32;
    let mut track = Track {
        id: agent.id,
        source_id: agent.id,
        agent_type: agent.agent_type as u32,
        status: TrackStatus::Confirmed as u32,
        state_len: 4,
        forecastable: u32::from(state_count >= Track::STATES_MIN),
        x_m: now.position_m[0],
        y_m: now.position_m[1],
        heading_rad: now.heading_rad,
        speed_mps: now.speed_mps(),
        vx_mps: now.velocity_mps[0],
        vy_mps: now.velocity_mps[1],
        length_m: agent.length_m.unwrap_or(0.0),
        existence: 1.0,
        ..Track::default()
    };
    track.type_probability[agent.agent_type as usize] = 1.0;
    for (step, state) in agent.history.iter().enumerate().take(HISTORY_MAX) {
        track.history[step] = state.map_or_else(HistoryState::default, |state| history_state(&state));
    }
    Some(track)
}

fn history_state(state: &State) -> HistoryState {
    HistoryState {
        x_m: state.position_m[0],
        y_m: state.position_m[1],
        vx_mps: state.velocity_mps[0],
        vy_mps: state.velocity_mps[1],
        heading_rad: state.heading_rad,
        present: 1,
    }
}
