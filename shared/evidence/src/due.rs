//! Matured forecasts whose level is not computed yet: a bounded sample in which all agents have equal
//! probability.

use wire::{AGENTS_MAX, MODES_MAX};

use crate::Context;

/// Maximum number of waiting levels.
const WAITING_MAX: usize = 4 * AGENTS_MAX;
/// Levels computed per second of the recording: 32 per tick of 80 ms.
const LEVELS_PER_S: f64 = 400.0;
/// Maximum number of levels computed at a time, however much time has passed.
const LEVELS_MAX: usize = 256;

/// A matured forecast at a knot, for the computation of its level.
#[derive(Clone, Copy, Debug)]
pub struct Matured<'a> {
    /// Positions of the modes, m.
    pub means_m: &'a [[f32; 2]],
    /// Their covariances as (xx, xy, yy), m².
    pub covariances_m2: &'a [[f32; 3]],
    /// Their probabilities.
    pub probability: &'a [f32],
    /// The agent's true position.
    pub truth_m: [f32; 2],
}

/// A matured forecast at a knot.
#[derive(Clone, Debug)]
pub(crate) struct Due {
    pub(crate) context: Context,
    pub(crate) knot: usize,
    /// Factor by which the forecast was widened, without the correction.
    pub(crate) factor: f32,
    pub(crate) modes_len: usize,
    pub(crate) probability: [f32; MODES_MAX],
    pub(crate) means_m: [[f32; 2]; MODES_MAX],
    pub(crate) covariances_m2: [[f32; 3]; MODES_MAX],
    pub(crate) truth_m: [f32; 2],
}

/// The waiting forecasts.
#[derive(Clone, Debug)]
pub(crate) struct Waiting {
    due: Vec<Due>,
    /// Number of forecasts matured since the sample became full.
    crowd_count: u64,
    /// State of a linear congruential generator.
    random: u64,
}

impl Due {
    pub(crate) fn matured(&self) -> Matured<'_> {
        let len = self.modes_len;
        Matured {
            means_m: &self.means_m[..len],
            covariances_m2: &self.covariances_m2[..len],
            probability: &self.probability[..len],
            truth_m: self.truth_m,
        }
    }
}

impl Waiting {
    pub(crate) fn new() -> Self {
        Self { due: Vec::with_capacity(WAITING_MAX), crowd_count: 0, random: 1 }
    }

    /// Adds a forecast. If the sample is full, each forecast since then is kept with equal probability
    /// ([reservoir sampling](https://doi.org/10.1145/3147.3165)).
    pub(crate) fn push(&mut self, due: Due) {
        if self.due.len() < WAITING_MAX {
            self.crowd_count = 0;
            self.due.push(due);
            return;
        }
        self.crowd_count += 1;
        let place = self.random_below(WAITING_MAX as u64 + self.crowd_count);
        if let Some(other) = self.due.get_mut(place) {
            *other = due;
        }
    }

    /// Takes forecasts at random, up to the number that the elapsed time allows. If they were taken in order,
    /// the early ones of a frame would wait longest and be replaced most often.
    pub(crate) fn take(&mut self, passed_s: f64) -> impl Iterator<Item = Due> + '_ {
        let len = ((LEVELS_PER_S * passed_s).ceil() as usize).min(LEVELS_MAX);
        (0..len.min(self.due.len())).map(|_| {
            let place = self.random_below(self.due.len() as u64);
            self.due.swap_remove(place)
        })
    }

    /// A number from 0 to 3, at random.
    pub(crate) fn any_of_four(&mut self) -> usize {
        self.random_below(4)
    }

    fn random_below(&mut self, bound: u64) -> usize {
        // Knuth's constants (MMIX); the high bits are the random ones.
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.random >> 33) % bound) as usize
    }

    pub(crate) fn clear(&mut self) {
        self.due.clear();
    }
}

#[cfg(test)]
mod tests {
    use wire::AgentType;

    use super::*;

    fn due(x_m: f32) -> Due {
        Due {
            context: Context::new(AgentType::Vehicle, 10.0),
            knot: 0,
            factor: 1.0,
            modes_len: 1,
            probability: [1.0; MODES_MAX],
            means_m: [[0.0; 2]; MODES_MAX],
            covariances_m2: [[1.0, 0.0, 1.0]; MODES_MAX],
            truth_m: [x_m, 0.0],
        }
    }

    #[test]
    fn of_a_crowd_late_ones_have_the_chance_of_early_ones() {
        let (mut waiting, mut computed) = (Waiting::new(), [0_u32; 8]);
        // Frames with two times and with eight times the number of forecasts that the time allows.
        for frame in 0..2000 {
            let len = if frame % 2 == 0 { 64 } else { 256 };
            (0..len).for_each(|number| waiting.push(due((8 * number / len) as f32)));
            waiting.take(0.08).for_each(|due| computed[due.truth_m[0] as usize] += 1);
        }
        let mean = computed.iter().sum::<u32>() as f32 / computed.len() as f32;
        let shares = computed.map(|computed| computed as f32 / mean);
        assert!(shares.iter().all(|share| (0.9..1.1).contains(share)), "{shares:?}");
    }

    #[test]
    fn as_many_are_computed_as_time_has_passed_and_no_more_than_a_limit() {
        let mut waiting = Waiting::new();
        (0..WAITING_MAX).for_each(|number| waiting.push(due(number as f32)));
        assert_eq!(waiting.take(0.0).count(), 0);
        assert_eq!(waiting.take(0.08).count(), 32);
        assert_eq!(waiting.take(60.0).count(), LEVELS_MAX);
        let left: std::collections::BTreeSet<u32> =
            waiting.take(60.0).map(|due| due.truth_m[0] as u32).collect();
        assert_eq!(left.len(), WAITING_MAX - 32 - LEVELS_MAX);
        assert_eq!(waiting.take(60.0).count(), 0);
    }
}
