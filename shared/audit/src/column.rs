//! Columns whose numbers stand for "unknown": zeros, or one number in all rows, although the agents move otherwise.

use crate::tally::{Place, Tally};

/// Smallest number of chords that contradict a number.
const CHORDS_MIN: u64 = 4;

/// A column of optional numbers, such as the speeds.
#[derive(Clone, Debug, Default)]
pub(crate) struct Column {
    /// The number of the first row.
    first: Option<f64>,
    /// Whether another number was found.
    varies: bool,
    /// Rows of all chords.
    rows: u64,
    zeros: Chords,
    /// Chords with the number of the first row.
    constants: Chords,
}

/// The chords whose rows all have one number.
#[derive(Clone, Copy, Debug, Default)]
struct Chords {
    chords: u64,
    /// Rows of chords that contradict the number.
    off: Tally,
    off_chords: u64,
}

/// A number that stands for "unknown".
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Unknown {
    pub value: f64,
    /// Rows of the chords that contradict it.
    pub tally: Tally,
    /// Rows of the compared chords.
    pub of: u64,
}

impl Column {
    /// Adds a row with a number.
    pub fn row(&mut self, value: f64) {
        let first = *self.first.get_or_insert(value);
        self.varies |= first != value;
    }

    /// Adds a chord with a direction, and the number if all its rows have the same one. Numbers up to `zero` count
    /// as 0.
    pub fn chord(
        &mut self,
        (value, zero): (Option<f64>, f64),
        is_off: impl Fn(f64) -> bool,
        rows: u64,
        place: Place,
    ) {
        self.rows += rows;
        let Some(value) = value else { return };
        let is_off = is_off(value);
        if value.abs() <= zero {
            self.zeros.add(is_off, rows, place);
        }
        if self.first == Some(value) {
            self.constants.add(is_off, rows, place);
        }
    }

    /// The number that stands for "unknown": it is in all rows, or it is zero and most chords with it contradict it.
    pub fn unknown(&self) -> Option<Unknown> {
        let of = |value, Chords { off, .. }: Chords| Unknown { value, tally: off, of: self.rows };
        let Chords { chords, off_chords, .. } = self.zeros;
        match self.first {
            Some(value) if !self.varies && self.constants.off_chords >= CHORDS_MIN => {
                Some(of(value, self.constants))
            }
            _ if off_chords >= CHORDS_MIN && 2 * off_chords >= chords => Some(of(0.0, self.zeros)),
            _ => None,
        }
    }
}

impl Chords {
    fn add(&mut self, is_off: bool, rows: u64, place: Place) {
        self.chords += 1;
        if is_off {
            self.off.add(rows, place);
            self.off_chords += 1;
        }
    }
}
