//! Which agent of a recording a track follows.

use std::collections::BTreeMap;

use data::RecordedTrack;
use wire::Forecast;

use crate::driving::sample::GAP_NS;
use crate::matching::{Placed, nearest};

/// The agent of each forecast, by its identity in the recording. `None` if no agent is near the track.
///
/// Tracks of detections with identities name their agent. Other tracks follow the [`nearest`] agent.
pub(crate) fn agents(
    forecasts: &[Forecast],
    truth: &BTreeMap<u64, RecordedTrack>,
    stamp_ns: i64,
    has_identities: bool,
) -> Vec<Option<u64>> {
    if has_identities {
        let named = |forecast: &Forecast| Some(forecast.source_id).filter(|id| truth.contains_key(id));
        return forecasts.iter().map(named).collect();
    }
    let (mut ids, mut here) = (Vec::new(), Vec::new());
    for track in truth.values() {
        let Some(state) = track.state_at(stamp_ns, i64::MAX, GAP_NS) else { continue };
        ids.push(track.id);
        let agent_type = track.reported_at(stamp_ns).agent_type as u32;
        here.push(Placed { agent_type, position_m: state.position_m });
    }
    let placed = |of: &Forecast| Placed { agent_type: of.agent_type, position_m: [of.x_m, of.y_m] };
    let placed: Vec<Placed> = forecasts.iter().map(placed).collect();
    nearest(&placed, &here).into_iter().map(|place| Some(ids[place?])).collect()
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;
    use data::Reported;
    use scene::{AgentType, State};

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
        let truth: BTreeMap<u64, RecordedTrack> = [
            standing(1, 0.0, AgentType::Vehicle),
            standing(2, 1.5, AgentType::Vehicle),
            standing(3, 9.0, AgentType::Pedestrian),
        ]
        .into();
        // Both are nearest to agent 1, but the second track is nearer.
        let tracks = [forecast(0, 0.7), forecast(0, 0.2), forecast(0, 9.0), forecast(0, 4.0)];
        assert_eq!(agents(&tracks, &truth, 0, false), [Some(2), Some(1), None, None]);
        // The recording has nobody at this time.
        assert_eq!(agents(&tracks, &truth, 2_000, false), [None; 4]);
    }

    #[test]
    fn a_track_with_identity_follows_its_agent_at_any_distance() {
        let truth: BTreeMap<u64, RecordedTrack> = [standing(1, 0.0, AgentType::Vehicle)].into();
        let tracks = [forecast(1, 50.0), forecast(7, 0.0)];
        assert_eq!(agents(&tracks, &truth, 0, true), [Some(1), None]);
    }
}
