/// Number of bins of a histogram. Each bin is 1.1 % wide.
const BINS: usize = 1_024;
/// Smallest and largest value with a separate bin.
const VALUES: [f64; 2] = [1e-2, 1e3];

/// Percentiles of positive values in bounded memory.
#[derive(Clone, Debug)]
pub(crate) struct Histogram {
    /// For each bin: the number of values and their sum.
    bins: Box<[(u32, f64)]>,
    len: u64,
}

impl Histogram {
    pub fn new() -> Self {
        Self { bins: vec![(0, 0.0); BINS].into(), len: 0 }
    }

    pub const fn len(&self) -> u64 {
        self.len
    }

    pub fn clear(&mut self) {
        self.bins.fill((0, 0.0));
        self.len = 0;
    }

    pub fn add(&mut self, value: f64) {
        let [low, high] = VALUES;
        let place = (value.max(low) / low).ln() / (high / low).ln() * BINS as f64;
        let bin = &mut self.bins[(place as usize).min(BINS - 1)];
        *bin = (bin.0 + 1, bin.1 + value);
        self.len += 1;
    }

    /// A percentile, as the mean of the values in its bin; `None` if there are no values.
    pub fn percentile(&self, percent: u64) -> Option<f64> {
        let rank = self.len.checked_sub(1)? * percent / 100;
        let mut before = 0;
        let bin = self.bins.iter().find(|(count, _)| {
            before += u64::from(*count);
            before > rank
        });
        bin.map(|(count, sum)| sum / f64::from(*count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_exact_within_a_bin() {
        let mut histogram = Histogram::new();
        assert_eq!(histogram.percentile(50), None);
        (1..=100).for_each(|value| histogram.add(f64::from(value)));
        for percent in [5, 50, 95] {
            let found = histogram.percentile(percent).expect("there are values");
            assert!((found / percent as f64 - 1.0).abs() < 0.03, "{percent}: {found}");
        }
        histogram.clear();
        histogram.add(1.4);
        assert_eq!((histogram.percentile(50), histogram.len()), (Some(1.4), 1));
    }
}
