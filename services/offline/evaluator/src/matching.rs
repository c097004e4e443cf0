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
    let apart_m = |track: usize, agent: usize| {
        let (track, agent) = (tracks[track], agents[agent]);
        let [x, y] = [0, 1].map(|axis| track.position_m[axis] - agent.position_m[axis]);
        let apart_m = x.hypot(y);
        (track.agent_type == agent.agent_type && apart_m <= NEAR_M).then_some(f64::from(apart_m))
    };
    let mut found = vec![None; tracks.len()];
    nearest_pairs([tracks.len(), agents.len()], apart_m).into_iter().for_each(|(t, a)| found[t] = Some(a));
    found
}

/// Pairs of two lists, the nearest first. Nothing is taken twice. `apart` returns the distance of two entries, or
/// `None` if they can't be a pair.
pub(crate) fn nearest_pairs(
    [first_len, second_len]: [usize; 2],
    apart: impl Fn(usize, usize) -> Option<f64>,
) -> Vec<(usize, usize)> {
    let all = (0..first_len).flat_map(|a| (0..second_len).map(move |b| (a, b)));
    let mut near: Vec<_> = all.filter_map(|(a, b)| Some((apart(a, b)?, a, b))).collect();
    near.sort_by(|one, other| one.0.total_cmp(&other.0).then((one.1, one.2).cmp(&(other.1, other.2))));
    let (mut first_taken, mut second_taken) = (vec![false; first_len], vec![false; second_len]);
    near.retain(|&(_, a, b)| {
        let is_free = !first_taken[a] && !second_taken[b];
        if is_free {
            (first_taken[a], second_taken[b]) = (true, true);
        }
        is_free
    });
    near.into_iter().map(|(_, a, b)| (a, b)).collect()
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
