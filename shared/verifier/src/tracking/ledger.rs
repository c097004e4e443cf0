use filters::wrapped;

use crate::Comparison;

/// The rule for comparing numbers.
#[derive(Clone, Copy)]
pub(super) struct Rule<'a> {
    /// Indices of the last dimension that are angles.
    pub(super) angles: &'a [usize],
    pub(super) tolerance: f64,
}

/// Numbers that f64 reproduces except for rounding.
pub(super) const EXACT: Rule<'static> = Rule { angles: &[], tolerance: 1e-9 };

/// Collects the comparisons.
#[derive(Default)]
pub(super) struct Ledger {
    pub(super) rows: Vec<Comparison>,
}

impl Ledger {
    /// Compares the numbers of a shape. NaN agrees with NaN.
    pub(super) fn compare(
        &mut self,
        name: String,
        shape: &[usize],
        found: &[f64],
        expected: &[f64],
        rule: &Rule<'_>,
    ) {
        let len: usize = shape.iter().product();
        assert!(found.len() == len && expected.len() == len, "{name} has {len} numbers");
        let row_len = shape.last().map_or(1, |len| *len).max(1);
        let errors = found.iter().zip(expected).enumerate().map(|(at, (&found, &expected))| {
            if found == expected || found.is_nan() && expected.is_nan() {
                return 0.0;
            }
            let off = found - expected;
            let off = if rule.angles.contains(&(at % row_len)) { wrapped(off) } else { off };
            off.abs() / expected.abs().max(1.0)
        });
        let numbers = expected.iter().copied();
        self.rows.push(Comparison::new(name, shape.to_vec(), numbers, errors, rule.tolerance));
    }
}
