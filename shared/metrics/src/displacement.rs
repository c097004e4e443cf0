use crate::{Mean, Point, Share, distance_m};

/// A forecast whose end is farther from the true end is a miss.
pub const MISS_RADIUS_M: f64 = 2.0;

/// How far a trajectory is from the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Displacement {
    /// Mean distance over the known steps (ADE); `None` where no step is known.
    pub ade_m: Option<f64>,
    /// Distance at the last step of the horizon (FDE); `None` where that step is unknown.
    pub fde_m: Option<f64>,
}

impl Displacement {
    /// Whether the end misses by more than [`MISS_RADIUS_M`]; `None` where the end is unknown.
    #[must_use]
    pub fn is_miss(&self) -> Option<bool> {
        self.fde_m.map(|fde_m| fde_m > MISS_RADIUS_M)
    }

    /// The smaller ADE and the smaller FDE of two, each by itself.
    fn or_better(self, other: Self) -> Self {
        let smaller = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        Self { ade_m: smaller(self.ade_m, other.ade_m), fde_m: smaller(self.fde_m, other.fde_m) }
    }
}

/// Mean of many displacements; ADE and FDE are counted apart, since some windows end before the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DisplacementMean {
    /// Mean of the ADEs.
    pub ade_m: Mean,
    /// Mean of the FDEs.
    pub fde_m: Mean,
    /// Share of known ends that were missed.
    pub misses: Share,
}

impl DisplacementMean {
    /// Counts one agent's displacement.
    pub fn add(&mut self, displacement: Displacement) {
        if let Some(ade_m) = displacement.ade_m {
            self.ade_m.add(ade_m);
        }
        if let Some(fde_m) = displacement.fde_m {
            self.fde_m.add(fde_m);
        }
        if let Some(miss) = displacement.is_miss() {
            self.misses.add(miss);
        }
    }

    /// Counts all that `other` counted.
    pub fn merge(&mut self, other: &Self) {
        self.ade_m.merge(&other.ade_m);
        self.fde_m.merge(&other.fde_m);
        self.misses.merge(&other.misses);
    }
}

/// Compares one trajectory with the truth.
///
/// # Panics
/// Where the trajectory is shorter than the truth.
#[must_use]
pub fn displacement(trajectory: &[Point], truth: &[Option<Point>]) -> Displacement {
    assert!(trajectory.len() >= truth.len(), "{} steps, truth has {}", trajectory.len(), truth.len());
    let (mut mean, mut fde_m) = (Mean::default(), None);
    for (&forecast, known) in trajectory.iter().zip(truth) {
        fde_m = known.map(|position| distance_m(forecast, position));
        if let Some(distance_m) = fde_m {
            mean.add(distance_m);
        }
    }
    Displacement { ade_m: mean.value(), fde_m }
}

/// Compares the best of several trajectories with the truth: ADE and FDE each have their own minimum, as in the
/// published best-of-20 figures.
///
/// # Panics
/// Where a trajectory is shorter than the truth.
#[must_use]
pub fn best_of<M: AsRef<[Point]>>(modes: &[M], truth: &[Option<Point>]) -> Displacement {
    let each = modes.iter().map(|mode| displacement(mode.as_ref(), truth));
    each.fold(Displacement::default(), Displacement::or_better)
}

/// Compares the best *joint* draw of a scene with the truth: mode k of every agent forms the k-th future of the
/// scene, and one k has to serve all agents. ADE and FDE have their own best k each; misses are those of the k with
/// the best FDE. Every agent counts once in the result.
///
/// # Panics
/// Where the agents have different numbers of modes, or a trajectory is shorter than the truth.
#[must_use]
pub fn joint_best_of<M: AsRef<[Point]>>(agents: &[(&[M], &[Option<Point>])]) -> DisplacementMean {
    let modes_len = agents.first().map_or(0, |(modes, _)| modes.len());
    assert!(agents.iter().all(|(modes, _)| modes.len() == modes_len), "agents differ in their modes");
    let futures: Vec<DisplacementMean> = (0..modes_len)
        .map(|k| {
            let mut mean = DisplacementMean::default();
            agents.iter().for_each(|(modes, truth)| mean.add(displacement(modes[k].as_ref(), truth)));
            mean
        })
        .collect();
    let best = |value: fn(&DisplacementMean) -> Option<f64>| {
        let order = |future: &&DisplacementMean| value(future).unwrap_or(f64::INFINITY);
        futures.iter().min_by(|a, b| order(a).total_cmp(&order(b))).copied().unwrap_or_default()
    };
    let (by_ade, by_fde) = (best(|future| future.ade_m.value()), best(|future| future.fde_m.value()));
    DisplacementMean { ade_m: by_ade.ade_m, fde_m: by_fde.fde_m, misses: by_fde.misses }
}

/// How far from its single best forecast towards a mode each of `agents_len` agents goes in one of `draws_len` futures of
/// their scene, from 0 to 1.
///
/// One agent alone goes all the way. The more agents share the futures, the less the number of a future can tell of each:
/// ln(K) / N nats, with which a source of D dimensions is best rendered at a variance smaller by 1 − K^(−2/(D·N)), its
/// rate-distortion bound. D = 2: where an agent ends up tells most of its future.
#[must_use]
pub fn joint_spread(agents_len: usize, draws_len: usize) -> f32 {
    const DIMENSIONS: f64 = 2.0;
    let rendered = |agents: f64| 1.0 - (draws_len.max(2) as f64).powf(-2.0 / (DIMENSIONS * agents));
    (rendered(agents_len.max(1) as f64) / rendered(1.0)).sqrt() as f32
}

/// The point `share` of the way from each position of `from` to that of `to`.
#[must_use]
pub fn part_way(from: &[Point], to: &[Point], share: f32) -> Vec<Point> {
    let between =
        |(from, to): (&Point, &Point)| [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
    from.iter().zip(to).map(between).collect()
}

/// Index of the largest probability, the first of equals; `None` for no modes.
#[must_use]
pub fn most_likely(probability: &[f32]) -> Option<usize> {
    (0..probability.len()).reduce(|best, k| if probability[k] > probability[best] { k } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TRUTH: [Option<Point>; 3] = [Some([1.0, 0.0]), Some([2.0, 0.0]), Some([3.0, 0.0])];

    #[test]
    fn mean_and_final_distance_by_hand() {
        // Distances 1, 0 and 5 (a 3-4-5 triangle).
        let d = displacement(&[[1.0, 1.0], [2.0, 0.0], [6.0, 4.0]], &TRUTH);
        assert_eq!(d, Displacement { ade_m: Some(2.0), fde_m: Some(5.0) });
        assert_eq!(d.is_miss(), Some(true));
    }

    #[test]
    fn unknown_steps_count_nowhere() {
        let truth = [Some([1.0, 0.0]), None, None];
        let d = displacement(&[[1.0, 4.0], [9.0, 9.0], [9.0, 9.0]], &truth);
        assert_eq!(d, Displacement { ade_m: Some(4.0), fde_m: None });
        assert_eq!(displacement(&[[0.0; 2]; 2], &[None, None]), Displacement::default());
    }

    #[test]
    fn best_ade_and_best_fde_may_come_from_different_modes() {
        let straight = [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]];
        let late = [[1.0, 9.0], [2.0, 9.0], [3.0, 0.0]];
        assert_eq!(best_of(&[straight, late], &TRUTH), Displacement { ade_m: Some(1.0), fde_m: Some(0.0) });
        assert_eq!(best_of::<[Point; 3]>(&[], &TRUTH), Displacement::default());
    }

    #[test]
    fn one_joint_mode_serves_all_agents() {
        // Mode 0 suits the first agent, mode 1 the second: marginally both are perfect, jointly one errs by 4 m.
        let truth = [Some([0.0, 0.0])];
        let (good, bad): ([Point; 1], [Point; 1]) = ([[0.0, 0.0]], [[4.0, 0.0]]);
        let (first, second) = ([good, bad], [bad, good]);
        let joint = joint_best_of(&[(&first[..], &truth[..]), (&second[..], &truth[..])]);
        assert_eq!(joint.ade_m.value(), Some(2.0));
        assert_eq!(joint.ade_m.len(), 2);
        assert_eq!(joint.misses.value(), Some(0.5));
        assert_eq!(best_of(&first, &truth).ade_m, Some(0.0));
    }

    #[test]
    fn many_agents_share_the_futures_of_a_scene() {
        let spreads: Vec<f32> = [1, 2, 5, 20, 1000].iter().map(|&agents| joint_spread(agents, 20)).collect();
        assert_eq!(spreads[0], 1.0);
        assert!(spreads.is_sorted_by(|a, b| a > b) && spreads[4] < 0.06, "{spreads:?}");
        // √((1 − 20^(−1/2)) / (1 − 1/20))
        assert!((spreads[1] - 0.904_11).abs() < 1e-4, "{spreads:?}");
        assert_eq!(part_way(&[[0.0, 2.0]], &[[4.0, 0.0]], 0.25), [[1.0, 1.5]]);
    }

    #[test]
    fn most_likely_takes_the_first_of_equals() {
        assert_eq!(most_likely(&[0.1, 0.4, 0.4, 0.1]), Some(1));
        assert_eq!(most_likely(&[]), None);
    }

    fn points(len: usize) -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec([-50.0f32..50.0, -50.0f32..50.0], len)
    }

    proptest! {
        #[test]
        fn more_modes_never_hurt(
            modes in prop::collection::vec(points(6), 1..8),
            truth in prop::collection::vec(prop::option::of([-50.0f32..50.0, -50.0f32..50.0]), 6),
        ) {
            let all = best_of(&modes, &truth);
            let some = best_of(&modes[..modes.len() - 1], &truth);
            let not_worse = |a: Option<f64>, b: Option<f64>| a.unwrap_or(f64::INFINITY) <= b.unwrap_or(f64::INFINITY);
            prop_assert!(not_worse(all.ade_m, some.ade_m) && not_worse(all.fde_m, some.fde_m));
        }

        #[test]
        fn joint_is_never_better_than_marginal(
            scene in prop::collection::vec((prop::collection::vec(points(4), 3), points(4)), 1..5),
        ) {
            let truths: Vec<Vec<Option<Point>>> =
                scene.iter().map(|(_, truth)| truth.iter().copied().map(Some).collect()).collect();
            let agents: Vec<_> =
                scene.iter().zip(&truths).map(|((modes, _), truth)| (&modes[..], &truth[..])).collect();
            let mut marginal = DisplacementMean::default();
            agents.iter().for_each(|(modes, truth)| marginal.add(best_of(modes, truth)));
            let joint = joint_best_of(&agents);
            prop_assert!(joint.ade_m.value() >= marginal.ade_m.value());
            prop_assert!(joint.fde_m.value() >= marginal.fde_m.value());
        }
    }
}
