//! Matured forecasts whose level is not computed yet: a bounded sample in which all agents have the same chance.

use std::collections::VecDeque;

use wire::{AGENTS_MAX, MODES_MAX};

use crate::{Context, Matured};

/// Most levels that wait.
const WAITING_MAX: usize = 4 * AGENTS_MAX;
/// Levels that are computed in a second of the recording, 32 in a tick of 80 ms.
const LEVELS_PER_S: f64 = 400.0;
/// Most levels that are computed at a time, whatever time has passed.
const LEVELS_MAX: usize = 256;

/// A matured forecast at a knot.
#[derive(Clone, Debug)]
pub(crate) struct Due {
    pub(crate) context: Context,
    pub(crate) knot: usize,
    /// Factor by which it was widened, without the correction.
    pub(crate) factor: f32,
    pub(crate) modes_len: usize,
    pub(crate) probability: [f32; MODES_MAX],
    pub(crate) means_m: [[f32; 2]; MODES_MAX],
    pub(crate) covariances_m2: [[f32; 3]; MODES_MAX],
    pub(crate) truth_m: [f32; 2],
}

/// Those that wait, the oldest first.
#[derive(Clone, Debug)]
pub(crate) struct Waiting {
    due: VecDeque<Due>,
    /// Forecasts that matured since there was room for all.
    crowd_len: u64,
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
        Self { due: VecDeque::with_capacity(WAITING_MAX), crowd_len: 0, random: 1 }
    }

    /// Adds one. Where too many wait, each of those that came since has the same chance to stay
    /// ([reservoir sampling](https://doi.org/10.1145/3147.3165)).
    pub(crate) fn push(&mut self, due: Due) {
        if self.due.len() < WAITING_MAX {
            self.crowd_len = 0;
            self.due.push_back(due);
            return;
        }
        self.crowd_len += 1;
        let among = WAITING_MAX as u64 + self.crowd_len;
        // Knuth's constants (MMIX); the high bits are the random ones.
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let place = ((self.random >> 33) % among) as usize;
        if let Some(other) = self.due.get_mut(place) {
            *other = due;
        }
    }

    /// Takes the oldest, as many as there is time for.
    pub(crate) fn take(&mut self, passed_s: f64) -> impl Iterator<Item = Due> + '_ {
        let len = ((LEVELS_PER_S * passed_s).ceil() as usize).min(LEVELS_MAX);
        self.due.drain(..len.min(self.due.len()))
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
        let mut waiting = Waiting::new();
        (0..4 * WAITING_MAX).for_each(|number| waiting.push(due(number as f32)));
        let kept: Vec<f32> = waiting.due.iter().map(|due| due.truth_m[0]).collect();
        for quarter in 0..4 {
            let range = (quarter * WAITING_MAX) as f32..((quarter + 1) * WAITING_MAX) as f32;
            let share = kept.iter().filter(|x_m| range.contains(x_m)).count() as f32 / WAITING_MAX as f32;
            assert!((0.17..0.33).contains(&share), "{share} of the quarter {quarter}");
        }
    }

    #[test]
    fn as_many_are_computed_as_time_has_passed_and_no_more_than_a_limit() {
        let mut waiting = Waiting::new();
        (0..WAITING_MAX).for_each(|number| waiting.push(due(number as f32)));
        assert_eq!(waiting.take(0.0).count(), 0);
        let first: Vec<f32> = waiting.take(0.08).map(|due| due.truth_m[0]).collect();
        assert_eq!((first.len(), first[0], first[31]), (32, 0.0, 31.0));
        assert_eq!(waiting.take(60.0).count(), LEVELS_MAX);
    }
}
