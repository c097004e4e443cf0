//! What was learned as plain numbers, for memory that outlives the process.

use wire::MODES_MAX;

use super::{Evidence, Knowledge};
use crate::blend::Blend;
use crate::familiarity::Familiarity;
use crate::fan::MIDDLES;
use crate::sets::{SetsAtSpeed, SetsOfType};
use crate::width::{Correction, Widths, single};
use crate::{BANDS, KNOTS};

/// Numbers in which all that was learned is written.
pub const NUMBERS_LEN: usize = 1 + 3 * (BANDS * KNOWLEDGE_LEN + OF_TYPE_LEN);
/// Those of one type at all speeds.
const OF_TYPE_LEN: usize =
    Familiarity::NUMBERS_LEN + SetsOfType::NUMBERS_LEN + KNOTS * Correction::NUMBERS_LEN;
/// Those of one type at one speed: the blend, the widths, the squares, what is nearer and the pattern.
const KNOWLEDGE_LEN: usize = KNOTS * (Blend::NUMBERS_LEN + Widths::NUMBERS_LEN + 3)
    + SetsAtSpeed::NUMBERS_LEN
    + MIDDLES.len()
    + MODES_MAX * (2 * KNOTS + 1);

impl Evidence {
    /// Spacing of the forecasts' steps.
    #[must_use]
    pub const fn step_ns(&self) -> u64 {
        self.step_ns.unsigned_abs()
    }

    /// Writes what was learned so far as numbers, which [`Evidence::resume`] takes: the forecasts that have not
    /// matured are left out. They begin with the newest time.
    ///
    /// # Panics
    /// If `out` has not [`NUMBERS_LEN`] places.
    pub fn write_numbers(&mut self, out: &mut [f64]) {
        assert_eq!(out.len(), NUMBERS_LEN, "a place per number");
        let [time, out @ ..] = out else { return };
        // Its bits: not all times are numbers of double precision.
        *time = f64::from_bits(self.now_ns.cast_unsigned());
        let mut places = out.iter_mut();
        self.numbers(&mut |number| {
            if let Some(place) = places.next() {
                *place = *number;
            }
        });
    }

    /// Goes on with what was learned before, under the same prior, as if all agents were new.
    ///
    /// # Errors
    /// If they are no such numbers; then nothing was changed.
    pub fn resume(&mut self, numbers: &[f64]) -> Result<(), &'static str> {
        let (NUMBERS_LEN, [time, numbers @ ..]) = (numbers.len(), numbers) else {
            return Err("number of the sums");
        };
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err("sums that are not finite");
        }
        self.end_session();
        self.now_ns = time.to_bits().cast_signed();
        let mut numbers = numbers.iter();
        self.numbers(&mut |own| {
            if let Some(number) = numbers.next() {
                *own = *number;
            }
        });
        Ok(())
    }

    fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        self.known.as_flattened_mut().iter_mut().for_each(|knowledge| knowledge.numbers(each));
        for of_type in &mut self.of_types {
            of_type.familiarity.numbers(each);
            of_type.sets.numbers(each);
            of_type.corrections.iter_mut().for_each(|correction| correction.numbers(each));
        }
    }

    /// Forecasts that have matured, older ones counting less, without those that the prior counts for.
    #[must_use]
    pub fn matured_len(&self) -> f64 {
        self.known.as_flattened().iter().map(|knowledge| knowledge.blend[KNOTS - 1].matured_len()).sum()
    }
}

impl Knowledge {
    /// Gives `each` all numbers that were learned, to read or to change.
    fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        self.blend.iter_mut().for_each(|blend| blend.numbers(each));
        self.widths.iter_mut().for_each(|widths| widths.numbers(each));
        for (squares, len) in &mut self.squares {
            squares.iter_mut().chain([len]).for_each(&mut *each);
        }
        self.sets.numbers(each);
        self.of_middles.numbers(each);
        self.pattern.numbers(&mut |number| single(number, each));
    }
}
