//! Lengths and widths of vehicles: feet, and length and width that are swapped.

use crate::finding::{Detail, Finding};
use crate::histogram::Histogram;
use crate::{Doubt, Place, Tally};

/// Smallest number of vehicles with a length.
const SIZED_MIN: u64 = 20;
/// Ratio of width to length from which a vehicle is wider than it is long.
const WIDE: f64 = 1.2;
/// Range of the median vehicle length if lengths are in feet.
const LENGTHS_FT: std::ops::RangeInclusive<f64> = 12.0..=20.0;
/// Width in metres of vehicles with such a length in metres, such as buses. Cars that are measured in feet are wider.
const WIDTHS_M: std::ops::Range<f64> = 1.0..3.5;

/// The sizes of vehicles.
#[derive(Clone, Debug)]
pub struct Sizes {
    lengths_m: Histogram,
    all: Tally,
    /// Detections of long vehicles that are as narrow as a bus.
    long: u64,
    /// Detections of vehicles that are wider than they are long.
    wide: Tally,
}

impl Sizes {
    pub fn new() -> Self {
        Self { lengths_m: Histogram::new(), all: Tally::default(), long: 0, wide: Tally::default() }
    }

    pub fn clear(&mut self) {
        self.lengths_m.clear();
        (self.all, self.long, self.wide) = (Tally::default(), 0, Tally::default());
    }

    pub fn row(&mut self, [length, width]: [f64; 2], place: Place) {
        self.lengths_m.add(length);
        self.all.add(1, place);
        if LENGTHS_FT.contains(&length) && WIDTHS_M.contains(&width) {
            self.long += 1;
        }
        if length > 0.0 && width > WIDE * length {
            self.wide.add(1, place);
        }
    }

    /// Median length.
    pub fn length_m(&self) -> Option<f64> {
        self.lengths_m.percentile(50)
    }

    /// The findings among `of` rows.
    pub fn visit(&self, of: u64, take: &mut impl FnMut(Finding)) {
        if self.all.rows < SIZED_MIN {
            return;
        }
        if let Some(length_m) = self.length_m().filter(|length_m| LENGTHS_FT.contains(length_m))
            && 2 * self.long < self.all.rows
        {
            take(Finding::new(Doubt::Feet, self.all, of, Detail::Length { length_m }));
        }
        if 2 * self.wide.rows > self.all.rows {
            take(Finding::new(Doubt::SizesSwapped, self.wide, of, Detail::None));
        }
    }
}
