//! Recordings that play through the pipeline, beside the recorded motion.

use std::collections::BTreeMap;

use data::{RecordedTrack, Recording};
use metrics::Point;
use onboard::Chain;
use scene::State;
use source::{Playback, PlaybackOptions};
use wire::{AgentType, Forecast, Header};

use crate::matching::{Placed, nearest};
use crate::noise::Noise;

/// Longest gap between two frames over which the truth is interpolated, ns.
pub(crate) const GAP_NS: i64 = 1_000_000_000;

/// The motion of agents by identity.
#[derive(Debug, Default)]
pub struct Truth(BTreeMap<u64, RecordedTrack>);

/// A recording on its way through the pipeline.
pub(crate) struct Playing {
    pub(crate) truth: Truth,
    pub(crate) playback: Playback,
    pub(crate) chain: Chain,
    pub(crate) has_identities: bool,
}

/// What the pipeline publishes at a tick.
pub(crate) struct Tick<'a> {
    pub(crate) header: Header,
    pub(crate) forecasts: &'a [Forecast],
    pub(crate) truth: &'a Truth,
    has_identities: bool,
}

/// A playback in lockstep.
pub(crate) fn playback(recording: Recording) -> Playback {
    Playback::new(recording, PlaybackOptions { lockstep: true, ..PlaybackOptions::default() })
}

impl Truth {
    /// The tracks of a recording.
    #[must_use]
    pub fn of(recording: &Recording) -> Self {
        Self(data::tracks(recording).into_iter().map(|track| (track.id, track)).collect())
    }

    /// The agents' tracks, in the order of their identities.
    pub fn tracks(&self) -> impl Iterator<Item = &RecordedTrack> {
        self.0.values()
    }

    pub(crate) fn track(&self, agent: u64) -> Option<&RecordedTrack> {
        self.0.get(&agent)
    }

    /// Adds a later state of an agent.
    pub fn add(&mut self, agent: u64, stamp_ns: i64, state: State) {
        let empty =
            || RecordedTrack { id: agent, states: Vec::new(), starts_unmoved: false, reported: Vec::new() };
        self.0.entry(agent).or_insert_with(empty).states.push((stamp_ns, state));
    }

    /// The state of an agent; `None` if there is none near this time.
    #[must_use]
    pub fn state(&self, agent: u64, at_ns: i64) -> Option<State> {
        self.track(agent)?.state_at(at_ns, i64::MAX, GAP_NS)
    }

    /// The known positions of an agent at `len` steps.
    #[must_use]
    pub fn positions(&self, agent: u64, stamp_ns: i64, step_ns: f64, len: usize) -> Vec<Option<Point>> {
        let at = |step: usize| {
            let at_ns = stamp_ns.checked_add((step as f64 * step_ns).round() as i64)?;
            Some(self.state(agent, at_ns)?.position_m)
        };
        (1..=len).map(at).collect()
    }

    /// The same; `None` unless all of them are known.
    pub(crate) fn ahead(
        &self,
        agent: u64,
        stamp_ns: i64,
        step_ns: f64,
        len: usize,
    ) -> Option<Vec<Option<Point>>> {
        let positions = self.positions(agent, stamp_ns, step_ns, len);
        positions.iter().all(Option::is_some).then_some(positions)
    }

    /// The agent of each forecast. `None` if no agent is near the track.
    ///
    /// Tracks of detections with identities name their agent. Other tracks follow the [`nearest`] agent.
    fn followed(&self, forecasts: &[Forecast], stamp_ns: i64, has_identities: bool) -> Vec<Option<u64>> {
        if has_identities {
            let named = |forecast: &Forecast| Some(forecast.source_id).filter(|id| self.0.contains_key(id));
            return forecasts.iter().map(named).collect();
        }
        let (mut ids, mut here) = (Vec::new(), Vec::new());
        for track in self.tracks() {
            let Some(state) = track.state_at(stamp_ns, i64::MAX, GAP_NS) else { continue };
            ids.push(track.id);
            let agent_type = track.reported_at(stamp_ns).agent_type as u32;
            here.push(Placed { agent_type, position_m: state.position_m });
        }
        let placed = |of: &Forecast| Placed { agent_type: of.agent_type, position_m: [of.x_m, of.y_m] };
        let placed: Vec<Placed> = forecasts.iter().map(placed).collect();
        nearest(&placed, &here).into_iter().map(|place| Some(ids[place?])).collect()
    }
}

impl Playing {
    /// The recording as a sensor reports it. `chain` makes the stages for the interval of the ticks, ns.
    pub(crate) fn new<E>(
        recording: &Recording,
        noise: &Noise,
        chain: impl FnOnce(u64) -> Result<Chain, E>,
    ) -> Result<Self, E> {
        let noisy = noise.applied_to(recording);
        let has_identities = noisy.has_identities;
        let playback = playback(noisy);
        let chain = chain(playback.interval_ns())?;
        Ok(Self { truth: Truth::of(recording), playback, chain, has_identities })
    }

    /// Plays the next tick; `None` at the end.
    pub(crate) fn next(&mut self) -> Option<Tick<'_>> {
        let Self { truth, playback, chain, has_identities } = self;
        let tick = playback.next_tick()?;
        let (_, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        Some(Tick { header: tick.header, forecasts, truth, has_identities: *has_identities })
    }
}

impl Tick<'_> {
    /// Each forecast of an agent of the recording, with the agent's track.
    pub(crate) fn followed(&self) -> impl Iterator<Item = (&Forecast, &RecordedTrack)> {
        let agents = self.truth.followed(self.forecasts, self.header.stamp_ns, self.has_identities);
        self.forecasts
            .iter()
            .zip(agents)
            .filter_map(|(forecast, agent)| Some((forecast, self.truth.track(agent?)?)))
    }
}

/// The type of a published agent.
pub(crate) fn type_of(forecast: &Forecast) -> Option<AgentType> {
    AgentType::try_from(forecast.agent_type).ok()
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;
    use data::Reported;

    use super::*;

    fn standing(id: u64, x_m: f32, agent_type: AgentType) -> (u64, RecordedTrack) {
        let state = State { position_m: [x_m, 0.0], velocity_mps: [0.0; 2], heading_rad: 0.0 };
        let reported =
            Reported { agent_type, length_m: 0.0, width_m: 0.0, has_speed: true, has_heading: true };
        let states = vec![(0, state), (1_000, state)];
        (id, RecordedTrack { id, states, starts_unmoved: false, reported: vec![(0, reported)] })
    }

    fn forecast(source_id: u64, x_m: f32) -> Forecast {
        Forecast { source_id, x_m, agent_type: AgentType::Vehicle as u32, ..Forecast::zeroed() }
    }

    #[test]
    fn a_track_without_identity_follows_the_nearest_agent_of_its_type() {
        let truth = Truth(
            [
                standing(1, 0.0, AgentType::Vehicle),
                standing(2, 1.5, AgentType::Vehicle),
                standing(3, 9.0, AgentType::Pedestrian),
            ]
            .into(),
        );
        // Both are nearest to agent 1, but the second track is nearer.
        let tracks = [forecast(0, 0.7), forecast(0, 0.2), forecast(0, 9.0), forecast(0, 4.0)];
        assert_eq!(truth.followed(&tracks, 0, false), [Some(2), Some(1), None, None]);
        // The recording has nobody at this time.
        assert_eq!(truth.followed(&tracks, 2_000, false), [None; 4]);
    }

    #[test]
    fn a_track_with_identity_follows_its_agent_at_any_distance() {
        let truth = Truth([standing(1, 0.0, AgentType::Vehicle)].into());
        let tracks = [forecast(1, 50.0), forecast(7, 0.0)];
        assert_eq!(truth.followed(&tracks, 0, true), [Some(1), None]);
    }
}
