use serde::{Deserialize, Serialize};

/// A running mean that can be merged with others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mean {
    sum: f64,
    len: u64,
}

impl Mean {
    /// Counts one value.
    pub fn add(&mut self, value: f64) {
        self.sum += value;
        self.len += 1;
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.len += other.len;
    }

    /// Number of values counted.
    pub const fn len(&self) -> u64 {
        self.len
    }

    /// Whether nothing was counted.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The mean; `None` if nothing was counted.
    pub fn value(&self) -> Option<f64> {
        (self.len > 0).then(|| self.sum / self.len as f64)
    }
}

/// The share of the counted cases that have a property. Shares can be merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Share(Mean);

impl Share {
    /// Counts one case.
    pub fn add(&mut self, hit: bool) {
        self.0.add(f64::from(u8::from(hit)));
    }

    /// Adds the counts of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.0.merge(&other.0);
    }

    /// Number of cases counted.
    pub const fn len(&self) -> u64 {
        self.0.len()
    }

    /// Whether nothing was counted.
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The share, 0 to 1; `None` if nothing was counted.
    pub fn value(&self) -> Option<f64> {
        self.0.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_means_equal_the_mean_of_the_whole() {
        let (mut left, mut right, mut whole) = (Mean::default(), Mean::default(), Mean::default());
        for x in [1.0, 2.0, 6.0] {
            left.add(x);
            whole.add(x);
        }
        right.add(7.0);
        whole.add(7.0);
        left.merge(&right);
        assert_eq!(left, whole);
        assert_eq!(left.value(), Some(4.0));
        assert_eq!(left.len(), 4);
    }

    #[test]
    fn empty_means_have_no_value() {
        assert_eq!(Mean::default().value(), None);
        assert_eq!(Share::default().value(), None);
        assert!(Share::default().is_empty());
    }

    #[test]
    fn share_is_hits_over_cases() {
        let mut share = Share::default();
        for hit in [true, false, false, true, true] {
            share.add(hit);
        }
        assert_eq!(share.value(), Some(0.6));
    }
}
