//! Which true agent a track without identity follows.

/// Maximum distance between a track and its agent, m.
const NEAR_M: f32 = 2.0;

/// The type and place of a track or of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// [`wire::AgentType`] as a number.
    pub agent_type: u32,
    /// Position.
    pub position_m: [f32; 2],
}

/// The agent that each track follows, by its place in `agents`. `None` if no agent of the type is within 2 m.
///
/// The nearest pair of track and agent is taken first. Neither a track nor an agent is taken twice.
#[must_use]
pub fn nearest(tracks: &[Placed], agents: &[Placed]) -> Vec<Option<usize>> {
    let mut pairs: Vec<(f32, usize, usize)> = Vec::new();
    for (track, of_track) in tracks.iter().enumerate() {
        for (agent, of_agent) in agents.iter().enumerate() {
            let [x, y] = [0, 1].map(|axis| of_track.position_m[axis] - of_agent.position_m[axis]);
            let apart_m = x.hypot(y);
            if of_track.agent_type == of_agent.agent_type && apart_m <= NEAR_M {
                pairs.push((apart_m, track, agent));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut found, mut is_taken) = (vec![None; tracks.len()], vec![false; agents.len()]);
    for (_, track, agent) in pairs {
        if found[track].is_none() && !is_taken[agent] {
            found[track] = Some(agent);
            is_taken[agent] = true;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(agent_type: u32, x_m: f32) -> Placed {
        Placed { agent_type, position_m: [x_m, 0.0] }
    }

    #[test]
    fn the_nearest_pair_is_taken_first_and_nothing_twice() {
        let agents = [placed(0, 0.0), placed(0, 1.5), placed(2, 9.0)];
        // Both of the first tracks are nearest to the first agent, but the second track is nearer.
        let tracks = [placed(0, 0.7), placed(0, 0.2), placed(0, 9.0), placed(0, 4.0), placed(2, 8.0)];
        assert_eq!(nearest(&tracks, &agents), [Some(1), Some(0), None, None, Some(2)]);
        assert_eq!(nearest(&tracks, &[]), [None; 5]);
    }
}
