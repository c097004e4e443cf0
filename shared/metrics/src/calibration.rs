use crate::Share;

/// How often truths lie inside the highest-density regions of their forecasts, by step and by level of the region.
///
/// A forecaster is calibrated where the share is the level: too low a share is overconfident, too high a timid one.
/// Can be merged with others of the same levels.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    levels: Vec<f64>,
    steps: Vec<Vec<Share>>,
}

impl Calibration {
    /// Counts nothing yet, at these levels (0.9 for the 90 % region).
    #[must_use]
    pub fn new(levels: &[f64]) -> Self {
        Self { levels: levels.to_vec(), steps: Vec::new() }
    }

    /// Counts a truth at a step of the horizon (0 is the first) by its
    /// [`highest_density_level`](crate::highest_density_level).
    pub fn add(&mut self, step: usize, truth_level: f64) {
        self.reach(step + 1);
        for (share, level) in self.steps[step].iter_mut().zip(&self.levels) {
            share.add(truth_level <= *level);
        }
    }

    /// Counts all that `other` counted.
    ///
    /// # Panics
    /// Where `other` has other levels.
    pub fn merge(&mut self, other: &Self) {
        assert_eq!(self.levels, other.levels, "the same levels");
        self.reach(other.steps.len());
        for (own, more) in self.steps.iter_mut().zip(&other.steps) {
            merge_shares(own, more);
        }
    }

    /// The levels, in the order given.
    #[must_use]
    pub fn levels(&self) -> &[f64] {
        &self.levels
    }

    /// The coverage of each level at each step up to the last that was counted.
    #[must_use]
    pub fn steps(&self) -> &[Vec<Share>] {
        &self.steps
    }

    /// The coverage of each level over all steps together.
    #[must_use]
    pub fn pooled(&self) -> Vec<Share> {
        let mut pooled = vec![Share::default(); self.levels.len()];
        self.steps.iter().for_each(|step| merge_shares(&mut pooled, step));
        pooled
    }

    fn reach(&mut self, steps_len: usize) {
        if self.steps.len() < steps_len {
            self.steps.resize(steps_len, vec![Share::default(); self.levels.len()]);
        }
    }
}

fn merge_shares(own: &mut [Share], more: &[Share]) {
    own.iter_mut().zip(more).for_each(|(own, more)| own.merge(more));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(shares: &[Share]) -> Vec<Option<f64>> {
        shares.iter().map(Share::value).collect()
    }

    #[test]
    fn coverage_by_step_and_pooled() {
        let mut calibration = Calibration::new(&[0.5, 0.9]);
        for (step, level) in [(0, 0.2), (0, 0.5), (0, 0.7), (0, 1.0), (2, 0.95)] {
            calibration.add(step, level);
        }
        let steps: Vec<_> = calibration.steps().iter().map(|step| values(step)).collect();
        assert_eq!(steps, [[Some(0.5), Some(0.75)], [None, None], [Some(0.0), Some(0.0)]]);
        assert_eq!(values(&calibration.pooled()), [Some(0.4), Some(0.6)]);
    }

    #[test]
    fn merged_parts_equal_the_whole() {
        let new = || Calibration::new(&[0.5, 0.9]);
        let (mut left, mut right, mut whole) = (new(), new(), new());
        for i in 0..30 {
            let level = f64::from(i * 7 % 30) / 30.0;
            let step = (i % 4) as usize;
            if step < 2 { &mut left } else { &mut right }.add(step, level);
            whole.add(step, level);
        }
        left.merge(&right);
        assert_eq!(left, whole);
    }

    #[test]
    #[should_panic(expected = "the same levels")]
    fn other_levels_cannot_be_merged() {
        Calibration::new(&[0.5]).merge(&Calibration::new(&[0.9]));
    }
}
