//! Recomputes the numbers of filters, assignments and measures of tracking.
//!
//! A folder holds one to four *parts*, folders themselves: `filters` (runs of Kalman filters over recorded
//! measurements), `assignment` (cost matrices and their optima), `metrics` (measures of one scenario,
//! distances of sets) and `unit` (Jacobians, association probabilities, a particle filter with its random
//! numbers, moments of samples). Every file is compared; one that nothing computes is refused, so that none
//! stays unverified.

mod assignments;
mod figures;
mod ledger;
mod measures;
mod part;
mod particles;
mod recording;
mod runs;
mod table;
mod unit;

use std::path::Path;

use super::{Comparison, VerifyError};
use ledger::Ledger;
use part::Part;

/// The folders that a folder of tracking may hold.
pub(super) const PARTS: [&str; 4] = ["filters", "assignment", "metrics", "unit"];

/// Compares every number of a folder, part by part.
pub(super) fn verify(folder: &Path) -> Result<Vec<Comparison>, VerifyError> {
    let mut ledger = Ledger::default();
    let comparers = [runs::compare, assignments::compare, measures::compare, unit::compare];
    for (name, compare) in PARTS.into_iter().zip(comparers) {
        if let Some(mut part) = Part::open(folder, name)? {
            compare(&mut part, &mut ledger)?;
            part.finish()?;
        }
    }
    Ok(ledger.rows)
}
