//! Recomputes the numbers of filters, assignments and tracking measures.
//!
//! A folder contains one to four *parts*, which are folders:
//!
//! * `filters`: runs of Kalman filters over recorded measurements;
//! * `assignment`: cost matrices and their optima;
//! * `metrics`: measures of one scenario, and distances of sets;
//! * `unit`: Jacobians, association probabilities, a particle filter with its random numbers, moments of
//!   samples.
//!
//! Every file is compared. A file whose numbers no code computes is refused, so no file stays unverified.

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

/// The parts that a folder of tracking may contain.
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
