//! Scenes whose histories are the tracks that a noisy sensor makes.
//!
//! A scene of a recording has exact histories. Here the recording passes through a [`Noise`] and then through
//! the pipeline. The histories that the tracker publishes replace the exact ones. The futures, which are the
//! truth, remain.

use data::Recording;
use metrics::Point;
use scene::track_history;
use wire::{AgentType, Track};

use super::Report;
use crate::error::EvaluateError;
use crate::footage::Footage;
use crate::forecaster::{Forecaster, MapInput};
use crate::matching::{Placed, nearest};
use crate::noise::Noise;
use crate::playback::Playing;
use crate::scenes::{Agent, Scene};
use crate::threads;

/// Marks the identities of tracks that follow no agent of the scene.
const NO_AGENT: u64 = 1 << 63;

/// A sensor with the stages behind it.
#[derive(Clone, Copy)]
pub(crate) struct Sensor<'a> {
    pub(crate) noise: Noise,
    pub(crate) forecaster: &'a Forecaster,
    pub(crate) map: MapInput<'a>,
}

impl Sensor<'_> {
    /// The recordings as the sensor sees them; unchanged without noise. Adds a line to the report about agents
    /// that no longer count, because the tracker has not published them for a whole history.
    pub(crate) fn observe_all(
        &self,
        footage: Vec<Footage>,
        threads: usize,
        part: &str,
        report: &mut Report,
    ) -> Result<Vec<Footage>, EvaluateError> {
        if self.noise.is_none() {
            return Ok(footage);
        }
        let observed = threads::each(&footage, threads, |footage, _: &mut ()| self.observe(footage));
        let observed = observed.into_iter().collect::<Result<Vec<_>, _>>()?;
        let count = |all: &[Footage]| {
            all.iter().flat_map(|footage| &footage.scenes).map(|scene| scene.complete().len()).sum::<usize>()
        };
        let (complete, published) = (count(&footage), count(&observed));
        if published < complete {
            let lost = complete - published;
            report.left_out.push(format!(
                "{part}: {lost} of {complete} agents of windows, which the tracker has not published for a whole history"
            ));
        }
        Ok(observed)
    }

    fn observe(&self, footage: &Footage) -> Result<Footage, EvaluateError> {
        let Footage { recording, scenes } = footage;
        let chain = |interval_ns| self.forecaster.chain(self.map, interval_ns);
        let playing = Playing::new(recording, &self.noise, chain);
        let mut playing = playing.map_err(|source| EvaluateError::unusable(&recording.name, source))?;
        let history_len = self.forecaster.config().history_len;
        let mut wanted = scenes.iter().peekable();
        let mut observed = Vec::with_capacity(scenes.len());
        while let Some(stamp_ns) = playing.next().map(|tick| tick.header.stamp_ns) {
            while wanted.next_if(|scene| scene.stamp_ns < stamp_ns).is_some() {}
            if let Some(scene) = wanted.next_if(|scene| scene.stamp_ns == stamp_ns) {
                observed.push(scene_of(scene, playing.chain.tracks(), playing.has_identities, history_len));
            }
        }
        Ok(Footage { recording: Recording::clone(recording), scenes: observed })
    }
}

/// The scene with the histories of the tracks. Agents without a track are absent. Tracks without an agent have
/// no future.
fn scene_of(scene: &Scene, tracks: &[Track], has_identities: bool, history_len: usize) -> Scene {
    let followed: Vec<Option<usize>> = if has_identities {
        let of_id = |track: &Track| scene.agents.iter().position(|agent| agent.id == track.source_id);
        tracks.iter().map(of_id).collect()
    } else {
        let placed =
            |agent_type: AgentType, position_m: Point| Placed { agent_type: agent_type as u32, position_m };
        let here = scene.agents.iter().map(|agent| {
            let far = [f32::INFINITY; 2];
            placed(agent.agent_type, agent.newest().map_or(far, |state| state.position_m))
        });
        let of_track =
            |track: &Track| Placed { agent_type: track.agent_type, position_m: [track.x_m, track.y_m] };
        nearest(&tracks.iter().map(of_track).collect::<Vec<_>>(), &here.collect::<Vec<_>>())
    };
    let mut agents: Vec<Agent> = tracks
        .iter()
        .zip(followed)
        .filter_map(|(track, place)| {
            let agent = place.map(|place| &scene.agents[place]);
            Some(Agent {
                id: agent.map_or(NO_AGENT | track.id, |agent| agent.id),
                agent_type: track.agent_type().ok()?,
                length_m: Some(track.length_m).filter(|length_m| *length_m > 0.0),
                history: track_history(track)[..history_len].to_vec(),
                future: agent.map_or_else(
                    || vec![None; scene.agents.first().map_or(0, |first| first.future.len())],
                    |agent| agent.future.clone(),
                ),
            })
        })
        .collect();
    agents.sort_by_key(|agent| agent.id);
    Scene { stamp_ns: scene.stamp_ns, agents }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;
    use scene::State;
    use wire::HistoryState;

    use super::*;

    fn agent(id: u64, x_m: f32) -> Agent {
        let state = State { position_m: [x_m, 0.0], velocity_mps: [1.0, 0.0], heading_rad: 0.0 };
        Agent {
            id,
            agent_type: AgentType::Pedestrian,
            length_m: None,
            history: vec![Some(state); 2],
            future: vec![Some([x_m + 1.0, 0.0]), Some([x_m + 2.0, 0.0])],
        }
    }

    fn track(source_id: u64, x_m: f32, states: usize) -> Track {
        let mut track = Track { id: 70, source_id, x_m, ..Track::zeroed() };
        track.agent_type = AgentType::Pedestrian as u32;
        for state in &mut track.history[2 - states..2] {
            *state = HistoryState { x_m, y_m: 0.1, vx_mps: 0.9, present: 1, ..HistoryState::zeroed() };
        }
        track
    }

    #[test]
    fn histories_are_the_tracks_and_futures_remain() {
        let scene = Scene { stamp_ns: 7, agents: vec![agent(1, 0.0), agent(2, 5.0), agent(3, 9.0)] };
        let tracks = [track(2, 5.2, 1), track(1, 0.2, 2), track(0, 30.0, 2)];
        for has_identities in [true, false] {
            let observed = scene_of(&scene, &tracks, has_identities, 2);
            assert_eq!((observed.stamp_ns, observed.agents.len()), (7, 3));
            let [one, two, other] = &observed.agents[..] else { panic!("three agents") };
            assert_eq!((one.id, two.id, other.id), (1, 2, NO_AGENT | 70));
            assert_eq!([&one.future, &two.future], [&scene.agents[0].future, &scene.agents[1].future]);
            assert_eq!(one.newest().unwrap().position_m, [0.2, 0.1]);
            assert_eq!(two.history[0], None);
            assert!(one.is_complete() && !two.is_complete() && !other.is_complete());
        }
    }
}
