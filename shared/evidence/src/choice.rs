//! Mode selection: the modes of the network and of the fan that are published together.

use wire::MODES_MAX;

use crate::KNOTS;

/// Number of modes of both sets together.
pub(crate) const BOTH_MAX: usize = 2 * MODES_MAX;

/// The selected modes: half of all modes of the network and of the [`Fan`](crate::Fan).
///
/// While more than half of the modes remain, drop the mode with the smallest p · d. Here p is its probability
/// and d the distance of its nearest neighbour, which inherits p. This is a greedy descent for k-medoids: it
/// minimises the mean distance of a mode to the nearest selected mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    modes_len: usize,
    /// A bit for each selected mode, the network's first.
    stays: u64,
    probability: [f32; BOTH_MAX],
}

impl Choice {
    /// Selects half of the modes, by their positions at the knots and their probabilities. The network's
    /// modes come first.
    pub(crate) fn new(modes_m: &[[[f32; 2]; KNOTS]], mut probability: [f32; BOTH_MAX]) -> Self {
        let (both, modes_len) = (modes_m.len(), modes_m.len() / 2);
        let mut distances_m = distances(modes_m);
        let nearest_of = |of_mode: &[f32; BOTH_MAX]| {
            let least = |(nearest, least_m), (mode, &distance_m)| {
                if distance_m < least_m { (mode, distance_m) } else { (nearest, least_m) }
            };
            of_mode.iter().enumerate().fold((0, f32::INFINITY), least)
        };
        let mut nearest = distances_m.each_ref().map(nearest_of);
        let mut stays: u64 = (1 << both) - 1;
        for _ in 0..both - modes_len {
            let missed = |mode: usize| probability[mode] * nearest[mode].1;
            let left = (0..both).filter(|&mode| stays & (1 << mode) != 0);
            let Some(gone) = left.min_by(|&a, &b| missed(a).total_cmp(&missed(b))) else { break };
            stays &= !(1 << gone);
            probability[nearest[gone].0] += probability[gone];
            for (nearest, of_mode) in nearest.iter_mut().zip(&mut distances_m) {
                of_mode[gone] = f32::INFINITY;
                if nearest.0 == gone {
                    *nearest = nearest_of(of_mode);
                }
            }
        }
        Self { modes_len, stays, probability }
    }

    /// The probability of a mode of the network, including the modes that it represents; `None` if it was
    /// dropped.
    #[must_use]
    pub fn of_network(&self, mode: usize) -> Option<f32> {
        (self.stays & (1 << mode) != 0).then(|| self.probability[mode])
    }

    /// As [`Choice::of_network`], for a mode of the fan.
    #[must_use]
    pub fn of_fan(&self, mode: usize) -> Option<f32> {
        self.of_network(self.modes_len + mode)
    }
}

/// For each pair of modes, the sum of their distances over the knots. Infinite between a mode and itself, and
/// for unused places.
fn distances(modes_m: &[[[f32; 2]; KNOTS]]) -> [[f32; BOTH_MAX]; BOTH_MAX] {
    // Stored by axis, so that the loop vectorises.
    let mut at = [[[0.0; BOTH_MAX]; 2]; KNOTS];
    for (mode, knots) in modes_m.iter().enumerate() {
        for (at, [x, y]) in at.iter_mut().zip(knots) {
            (at[0][mode], at[1][mode]) = (*x, *y);
        }
    }
    let mut distances_m = [[f32::INFINITY; BOTH_MAX]; BOTH_MAX];
    for (mode, (of_mode, knots)) in distances_m.iter_mut().zip(modes_m).enumerate() {
        let mut sums = [0.0; BOTH_MAX];
        for ([x, y], [xs, ys]) in knots.iter().zip(&at) {
            for (sum, (other_x, other_y)) in sums.iter_mut().zip(xs.iter().zip(ys)) {
                let (dx, dy) = (other_x - x, other_y - y);
                *sum += (dx * dx + dy * dy).sqrt();
            }
        }
        of_mode[..modes_m.len()].copy_from_slice(&sums[..modes_m.len()]);
        of_mode[mode] = f32::INFINITY;
    }
    distances_m
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Selects from modes at these places along a line.
    fn choose(network: &[(f32, f32)], fan: &[(f32, f32)]) -> Choice {
        let both = network.iter().chain(fan);
        let modes_m: Vec<_> = both.clone().map(|(x_m, _)| [[*x_m, 0.0]; KNOTS]).collect();
        let mut probability = [0.0; BOTH_MAX];
        both.zip(&mut probability).for_each(|((_, p), probability)| *probability = *p);
        Choice::new(&modes_m, probability)
    }

    #[test]
    fn of_two_that_are_near_the_less_probable_one_goes_and_the_other_stands_for_both() {
        let choice = choose(&[(0.0, 0.375), (10.0, 0.125)], &[(0.1, 0.25), (-8.0, 0.25)]);
        let of_network: Vec<_> = (0..2).map(|mode| choice.of_network(mode)).collect();
        let of_fan: Vec<_> = (0..2).map(|mode| choice.of_fan(mode)).collect();
        // The second mode to be dropped is at 10 m: 0.125 · 10 m is less than 0.25 · 8 m.
        assert_eq!((of_network, of_fan), (vec![Some(0.75), None], vec![None, Some(0.25)]));
    }

    #[test]
    fn as_many_stay_as_a_set_has_and_nothing_of_the_probability_is_lost() {
        let modes = |from: f32| -> Vec<(f32, f32)> {
            (0..MODES_MAX).map(|mode| ((from + mode as f32 * 1.7) % 11.0, 0.5 / MODES_MAX as f32)).collect()
        };
        let choice = choose(&modes(0.0), &modes(0.4));
        let stay: Vec<f32> = (0..BOTH_MAX).filter_map(|mode| choice.of_network(mode)).collect();
        assert_eq!(stay.len(), MODES_MAX);
        assert!((stay.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{stay:?}");
    }
}
