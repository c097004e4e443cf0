//! True positions of all agents, kept while a waiting forecast may need them.

use std::collections::{BTreeMap, VecDeque};

use metrics::Point;
use wire::{Rejected, Truth};

/// Longest gap between two samples of an agent for interpolation. Annotations at 2.5 Hz are 0.4 s apart.
pub const GAP_MAX_NS: i64 = 500_000_000;
/// Largest number of samples per agent.
const SAMPLES_MAX: usize = 512;
/// Largest number of agents. Further agents are ignored.
const AGENTS_MAX: usize = 4_096;

#[derive(Clone, Copy, Debug)]
struct Sample {
    stamp_ns: i64,
    position_m: Point,
}

#[derive(Clone, Debug)]
struct Path {
    agent_type: u32,
    samples: VecDeque<Sample>,
}

impl Path {
    /// The position at `stamp_ns`: as recorded, or between two samples at most [`GAP_MAX_NS`] apart.
    fn at(&self, stamp_ns: i64) -> Option<Point> {
        let after = self.samples.partition_point(|sample| sample.stamp_ns < stamp_ns);
        let next = self.samples.get(after)?;
        if next.stamp_ns == stamp_ns {
            return Some(next.position_m);
        }
        let previous = self.samples.get(after.checked_sub(1)?)?;
        let gap_ns = next.stamp_ns - previous.stamp_ns;
        if gap_ns > GAP_MAX_NS {
            return None;
        }
        let share = (stamp_ns - previous.stamp_ns) as f64 / gap_ns as f64;
        let between = |axis: usize| {
            let (a, b) = (f64::from(previous.position_m[axis]), f64::from(next.position_m[axis]));
            (a + share * (b - a)) as f32
        };
        Some([between(0), between(1)])
    }
}

/// The paths of all agents, by identity.
#[derive(Clone, Debug, Default)]
pub struct Paths {
    paths: BTreeMap<u64, Path>,
    newest_ns: Option<i64>,
}

impl Paths {
    /// Adds the truth of the frame at `stamp_ns`, each position at its own time.
    ///
    /// # Errors
    /// [`Rejected`] if a position is not finite or the stamp is not later than the last one; nothing is added
    /// then.
    pub fn add(&mut self, stamp_ns: i64, truths: &[Truth]) -> Result<(), Rejected> {
        if let Some(last_ns) = self.newest_ns.filter(|&last_ns| stamp_ns <= last_ns) {
            return Err(Rejected::NotNewer { stamp_ns, last_ns });
        }
        for truth in truths {
            wire::finite("truth position", &[truth.x_m, truth.y_m])?;
        }
        self.newest_ns = Some(stamp_ns);
        for truth in truths {
            if self.paths.len() >= AGENTS_MAX && !self.paths.contains_key(&truth.id) {
                continue;
            }
            let path = self
                .paths
                .entry(truth.id)
                .or_insert_with(|| Path { agent_type: truth.agent_type, samples: VecDeque::new() });
            path.agent_type = truth.agent_type;
            let stamp_ns = stamp_ns.saturating_add(truth.offset_ns);
            if path.samples.back().is_some_and(|sample| sample.stamp_ns >= stamp_ns) {
                continue;
            }
            if path.samples.len() == SAMPLES_MAX {
                path.samples.pop_front();
            }
            path.samples.push_back(Sample { stamp_ns, position_m: [truth.x_m, truth.y_m] });
        }
        Ok(())
    }

    /// Stamp of the newest truth.
    pub const fn newest_ns(&self) -> Option<i64> {
        self.newest_ns
    }

    /// Removes samples on which no position at `stamp_ns` or later depends.
    pub fn forget_before(&mut self, stamp_ns: i64) {
        let oldest_ns = stamp_ns.saturating_sub(GAP_MAX_NS);
        self.paths.retain(|_, path| {
            while path.samples.front().is_some_and(|sample| sample.stamp_ns < oldest_ns) {
                path.samples.pop_front();
            }
            !path.samples.is_empty()
        });
    }

    /// Whether there are samples of the agent.
    pub fn knows(&self, id: u64) -> bool {
        self.paths.contains_key(&id)
    }

    /// The position of agent `id` at `stamp_ns`, if the truth covers it.
    pub fn at(&self, id: u64, stamp_ns: i64) -> Option<Point> {
        self.paths.get(&id)?.at(stamp_ns)
    }

    /// The agent of a type that is nearest to `position_m` at `stamp_ns`, at most `radius_m` away. Of two
    /// agents at the same distance, this is the one with the smaller identity.
    pub fn nearest(&self, agent_type: u32, position_m: Point, stamp_ns: i64, radius_m: f32) -> Option<u64> {
        let distance_m = |[x, y]: Point| (x - position_m[0]).hypot(y - position_m[1]);
        self.paths
            .iter()
            .filter(|(_, path)| path.agent_type == agent_type)
            .filter_map(|(&id, path)| Some((id, distance_m(path.at(stamp_ns)?))))
            .filter(|&(_, distance_m)| distance_m <= radius_m)
            .min_by(|(_, a), (_, b)| a.total_cmp(b))
            .map(|(id, _)| id)
    }

    #[cfg(test)]
    pub fn sample_count(&self) -> usize {
        self.paths.values().map(|path| path.samples.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_NS: i64 = 80_000_000;

    fn truth(id: u64, x_m: f32) -> Truth {
        Truth { id, x_m, ..Truth::default() }
    }

    fn paths(frames: &[(i64, &[Truth])]) -> Paths {
        let mut paths = Paths::default();
        for (stamp_ns, truths) in frames {
            paths.add(*stamp_ns, truths).unwrap();
        }
        paths
    }

    #[test]
    fn positions_are_interpolated_and_not_extrapolated() {
        let paths = paths(&[(0, &[truth(1, 0.0)]), (400_000_000, &[truth(1, 4.0)])]);
        assert_eq!(paths.at(1, 100_000_000), Some([1.0, 0.0]));
        assert_eq!(paths.at(1, 400_000_000), Some([4.0, 0.0]));
        assert_eq!(paths.at(1, 400_000_001), None, "nothing is extrapolated");
        assert_eq!(paths.at(1, -1), None);
        assert_eq!(paths.at(2, 0), None);
    }

    #[test]
    fn positions_lie_at_their_own_times() {
        let late = |x_m| Truth { offset_ns: -30_000_000, ..truth(1, x_m) };
        let paths = paths(&[(0, &[late(0.0)]), (100_000_000, &[late(1.0)])]);
        assert_eq!(paths.at(1, 70_000_000), Some([1.0, 0.0]));
        assert_eq!(paths.at(1, 20_000_000), Some([0.5, 0.0]));
        assert_eq!(paths.at(1, 100_000_000), None, "the newest position is older");
    }

    #[test]
    fn long_gaps_are_not_interpolated() {
        let paths = paths(&[(0, &[truth(1, 0.0)]), (GAP_MAX_NS + 1, &[truth(1, 4.0)])]);
        assert_eq!(paths.at(1, 100), None);
    }

    #[test]
    fn the_nearest_of_the_type_within_the_radius_matches() {
        let cyclist = Truth { agent_type: 1, ..truth(9, 0.1) };
        let paths = paths(&[(0, &[truth(1, 1.5), truth(2, -1.0), cyclist])]);
        assert_eq!(paths.nearest(0, [0.0, 0.0], 0, 2.0), Some(2));
        assert_eq!(paths.nearest(1, [0.0, 0.0], 0, 2.0), Some(9));
        assert_eq!(paths.nearest(0, [9.0, 0.0], 0, 2.0), None);
    }

    #[test]
    fn stale_or_invalid_truth_is_refused_as_a_whole() {
        let mut paths = paths(&[(TICK_NS, &[truth(1, 0.0)])]);
        assert_eq!(
            paths.add(TICK_NS, &[truth(1, 1.0)]),
            Err(Rejected::NotNewer { stamp_ns: TICK_NS, last_ns: TICK_NS })
        );
        assert!(paths.add(2 * TICK_NS, &[truth(1, 1.0), truth(2, f32::NAN)]).is_err());
        assert_eq!((paths.newest_ns(), paths.sample_count()), (Some(TICK_NS), 1));
    }

    #[test]
    fn forgotten_samples_free_their_memory() {
        let mut paths = Paths::default();
        for tick in 0..1_000 {
            paths.add(tick * TICK_NS, &[truth(tick as u64, 0.0)]).unwrap();
            paths.forget_before(tick * TICK_NS);
            assert!(paths.sample_count() <= 7, "{} samples", paths.sample_count());
        }
    }
}
