use association::Candidate;
use association::assignment::Assigner;

/// A possible pair, and the gain of choosing it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub truth: u64,
    pub track: u64,
    /// Finite. A pair with a gain of 0 or less is never chosen.
    pub gain: f64,
}

/// Numbers (ascending) of the edges with the largest total gain. Each truth and each track is in at most one
/// of these edges.
///
/// Truths and tracks have ids of any value. A pair may occur only once.
pub(super) fn best_pairs(edges: &[Edge]) -> Vec<usize> {
    let truths = distinct(edges.iter().map(|edge| edge.truth));
    let tracks = distinct(edges.iter().map(|edge| edge.track));
    let ends = |edge: &Edge| (place(&truths, edge.truth), place(&tracks, edge.track));
    let candidate = |edge: &Edge| {
        let (track, detection) = ends(edge);
        Candidate { track, detection, cost: -edge.gain }
    };
    let mut candidates = edges.iter().map(candidate).collect();
    let mut paired = vec![None; truths.len()];
    Assigner::default().solve(&mut candidates, tracks.len(), 0.0, &mut paired);
    let chosen = |edge: &Edge| {
        let (truth, track) = ends(edge);
        paired[truth as usize] == Some(track)
    };
    (0..edges.len()).filter(|&i| chosen(&edges[i])).collect()
}

fn distinct(numbers: impl Iterator<Item = u64>) -> Vec<u64> {
    let mut numbers: Vec<u64> = numbers.collect();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

fn place(numbers: &[u64], number: u64) -> u32 {
    numbers.partition_point(|&other| other < number) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(truth: u64, track: u64, gain: f64) -> Edge {
        Edge { truth, track, gain }
    }

    #[test]
    fn two_pairs_of_greater_total_gain_are_chosen() {
        let edges = [edge(7, 90, 5.0), edge(7, 4, 4.0), edge(u64::MAX, 90, 4.0), edge(8, 1, 0.0)];
        assert_eq!(best_pairs(&edges), [1, 2]);
        assert_eq!(best_pairs(&[]), [0; 0]);
    }

    #[test]
    fn one_pair_of_greater_gain_than_two_is_chosen() {
        assert_eq!(best_pairs(&[edge(0, 0, 9.0), edge(0, 1, 4.0), edge(1, 0, 4.0)]), [0]);
    }
}
