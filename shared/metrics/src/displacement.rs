use crate::{Mean, Point, Share, distance_m};

/// Final displacement above which a forecast is a miss.
pub const MISS_RADIUS_M: f64 = 2.0;

/// Displacement errors of a trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Displacement {
    /// Mean distance over the known steps (ADE); `None` if no step is known.
    pub ade_m: Option<f64>,
    /// Distance at the last step of the horizon (FDE); `None` if that step is unknown.
    pub fde_m: Option<f64>,
}

/// Mean ADE and FDE of forecasts, m.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Errors {
    /// Mean distance over the steps.
    pub ade_m: f64,
    /// Distance at the last step.
    pub fde_m: f64,
}

impl Errors {
    /// The errors of one forecast; NaN if they are unknown.
    #[must_use]
    pub fn of(displacement: Displacement) -> Self {
        Self { ade_m: displacement.ade_m.unwrap_or(f64::NAN), fde_m: displacement.fde_m.unwrap_or(f64::NAN) }
    }
}

impl Displacement {
    /// Whether the FDE is above [`MISS_RADIUS_M`]; `None` if the FDE is unknown.
    pub fn is_miss(&self) -> Option<bool> {
        self.fde_m.map(|fde_m| fde_m > MISS_RADIUS_M)
    }

    /// The smaller ADE and the smaller FDE of two displacements, independently.
    fn min(self, other: Self) -> Self {
        let smaller = |a: Option<f64>, b: Option<f64>| match (a, b) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        Self { ade_m: smaller(self.ade_m, other.ade_m), fde_m: smaller(self.fde_m, other.fde_m) }
    }
}

/// Mean of many displacements. ADE and FDE have separate counts because some windows end before the horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DisplacementMean {
    /// Mean of the ADEs.
    pub ade_m: Mean,
    /// Mean of the FDEs.
    pub fde_m: Mean,
    /// Miss rate: share of the known FDEs above [`MISS_RADIUS_M`].
    pub miss_rate: Share,
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
            self.miss_rate.add(miss);
        }
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.ade_m.merge(&other.ade_m);
        self.fde_m.merge(&other.fde_m);
        self.miss_rate.merge(&other.miss_rate);
    }
}

/// ADE and FDE of one trajectory.
///
/// # Panics
/// If the trajectory is shorter than the truth.
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

/// minADE and minFDE over several trajectories. The two minima are independent, as in the published minADE₂₀
/// and minFDE₂₀.
///
/// # Panics
/// If a trajectory is shorter than the truth.
#[must_use]
pub fn min_displacement<M: AsRef<[Point]>>(modes: &[M], truth: &[Option<Point>]) -> Displacement {
    let each = modes.iter().map(|mode| displacement(mode.as_ref(), truth));
    each.fold(Displacement::default(), Displacement::min)
}

/// Joint minADE and minFDE of a scene.
///
/// Mode k of every agent forms the k-th joint future, and one k serves all agents. ADE and FDE each have
/// their own best k. The miss rate is taken from the k with the best FDE. Every agent counts once in the
/// result.
///
/// # Panics
/// If the agents have different numbers of modes, or a trajectory is shorter than the truth.
#[must_use]
pub fn joint_min_displacement<M: AsRef<[Point]>>(agents: &[(&[M], &[Option<Point>])]) -> DisplacementMean {
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
    DisplacementMean { ade_m: by_ade.ade_m, fde_m: by_fde.fde_m, miss_rate: by_fde.miss_rate }
}

/// How far each mode of a joint future is moved away from an agent's single best forecast: 0 is the single
/// best forecast, 1 the mode itself.
///
/// ```text
/// spread² = (1 − K^(−2/(D N))) / (1 − K^(−2/D))      K = draw_count, N = agents_len, D = 2
/// ```
///
/// The spread is 1 for a single agent. A future's number carries ln(K) / N nats of information about each of
/// N agents. By the rate-distortion bound, a source of D dimensions is best rendered with a variance that is
/// smaller by the factor 1 − K^(−2/(D N)). D is 2 because the end point has most of the information about a
/// future.
#[must_use]
pub fn joint_spread(agents_len: usize, draw_count: usize) -> f32 {
    const DIMENSIONS: f64 = 2.0;
    let rendered = |agents: f64| 1.0 - (draw_count.max(2) as f64).powf(-2.0 / (DIMENSIONS * agents));
    (rendered(agents_len.max(1) as f64) / rendered(1.0)).sqrt() as f32
}

/// The trajectory at `share` of the way from `from` to `to`, position by position.
#[must_use]
pub fn interpolated(from: &[Point], to: &[Point], share: f32) -> Vec<Point> {
    let between =
        |(from, to): (&Point, &Point)| [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
    from.iter().zip(to).map(between).collect()
}

/// Top-1: index of the largest probability, the first among equals. Returns `None` if `probability` is empty.
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
    fn ade_and_fde_equal_values_by_hand() {
        // Distances 1, 0 and 5 (a 3-4-5 triangle).
        let d = displacement(&[[1.0, 1.0], [2.0, 0.0], [6.0, 4.0]], &TRUTH);
        assert_eq!(d, Displacement { ade_m: Some(2.0), fde_m: Some(5.0) });
        assert_eq!(d.is_miss(), Some(true));
    }

    #[test]
    fn unknown_steps_are_not_counted() {
        let truth = [Some([1.0, 0.0]), None, None];
        let d = displacement(&[[1.0, 4.0], [9.0, 9.0], [9.0, 9.0]], &truth);
        assert_eq!(d, Displacement { ade_m: Some(4.0), fde_m: None });
        assert_eq!(displacement(&[[0.0; 2]; 2], &[None, None]), Displacement::default());
    }

    #[test]
    fn min_ade_and_min_fde_come_from_different_modes() {
        let straight = [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]];
        let late = [[1.0, 9.0], [2.0, 9.0], [3.0, 0.0]];
        assert_eq!(
            min_displacement(&[straight, late], &TRUTH),
            Displacement { ade_m: Some(1.0), fde_m: Some(0.0) }
        );
        assert_eq!(min_displacement::<[Point; 3]>(&[], &TRUTH), Displacement::default());
    }

    #[test]
    fn joint_minimum_uses_one_mode_for_all_agents() {
        // Mode 0 fits the first agent and mode 1 the second. Each minADE is 0; jointly one agent errs by 4 m.
        let truth = [Some([0.0, 0.0])];
        let (good, bad): ([Point; 1], [Point; 1]) = ([[0.0, 0.0]], [[4.0, 0.0]]);
        let (first, second) = ([good, bad], [bad, good]);
        let joint = joint_min_displacement(&[(&first[..], &truth[..]), (&second[..], &truth[..])]);
        assert_eq!(joint.ade_m.value(), Some(2.0));
        assert_eq!(joint.ade_m.len(), 2);
        assert_eq!(joint.miss_rate.value(), Some(0.5));
        assert_eq!(min_displacement(&first, &truth).ade_m, Some(0.0));
    }

    #[test]
    fn joint_spread_falls_with_agents_to_the_rate_distortion_bound() {
        let spreads: Vec<f32> = [1, 2, 5, 20, 1000].iter().map(|&agents| joint_spread(agents, 20)).collect();
        assert_eq!(spreads[0], 1.0);
        assert!(spreads.is_sorted_by(|a, b| a > b) && spreads[4] < 0.06, "{spreads:?}");
        // √((1 − 20^(−1/2)) / (1 − 1/20))
        assert!((spreads[1] - 0.904_11).abs() < 1e-4, "{spreads:?}");
        assert_eq!(interpolated(&[[0.0, 2.0]], &[[4.0, 0.0]], 0.25), [[1.0, 1.5]]);
    }

    #[test]
    fn most_likely_is_the_first_of_equals() {
        assert_eq!(most_likely(&[0.1, 0.4, 0.4, 0.1]), Some(1));
        assert_eq!(most_likely(&[]), None);
    }

    fn points(len: usize) -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec([-50.0f32..50.0, -50.0f32..50.0], len)
    }

    proptest! {
        #[test]
        fn more_modes_never_raise_the_minimum(
            modes in prop::collection::vec(points(6), 1..8),
            truth in prop::collection::vec(prop::option::of([-50.0f32..50.0, -50.0f32..50.0]), 6),
        ) {
            let all = min_displacement(&modes, &truth);
            let some = min_displacement(&modes[..modes.len() - 1], &truth);
            let not_worse = |a: Option<f64>, b: Option<f64>| a.unwrap_or(f64::INFINITY) <= b.unwrap_or(f64::INFINITY);
            prop_assert!(not_worse(all.ade_m, some.ade_m) && not_worse(all.fde_m, some.fde_m));
        }

        #[test]
        fn joint_minimum_is_never_below_the_marginal(
            scene in prop::collection::vec((prop::collection::vec(points(4), 3), points(4)), 1..5),
        ) {
            let truths: Vec<Vec<Option<Point>>> =
                scene.iter().map(|(_, truth)| truth.iter().copied().map(Some).collect()).collect();
            let agents: Vec<_> =
                scene.iter().zip(&truths).map(|((modes, _), truth)| (&modes[..], &truth[..])).collect();
            let mut marginal = DisplacementMean::default();
            agents.iter().for_each(|(modes, truth)| marginal.add(min_displacement(modes, truth)));
            let joint = joint_min_displacement(&agents);
            prop_assert!(joint.ade_m.value() >= marginal.ade_m.value());
            prop_assert!(joint.fde_m.value() >= marginal.fde_m.value());
        }
    }
}
