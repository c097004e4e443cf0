//! The learned state as plain numbers, for memory that outlives the process.

use wire::MODES_MAX;

use super::{Evidence, Knowledge};
use crate::blend::Blend;
use crate::familiarity::Familiarity;
use crate::fan::MIDDLES;
use crate::sets::{SetsAtSpeed, SetsOfType};
use crate::width::{Correction, Widths, single};
use crate::{BANDS, KNOTS};

/// Count of the numbers of the whole learned state.
pub const NUMBERS_LEN: usize = 1 + 3 * (BANDS * KNOWLEDGE_LEN + OF_TYPE_LEN);
/// Count for one type at all speeds.
const OF_TYPE_LEN: usize =
    Familiarity::NUMBERS_LEN + SetsOfType::NUMBERS_LEN + KNOTS * Correction::NUMBERS_LEN;
/// Count for one type at one speed: the blend, the widths, the squares, the shares and the pattern.
const KNOWLEDGE_LEN: usize = KNOTS * (Blend::NUMBERS_LEN + Widths::NUMBERS_LEN + 3)
    + SetsAtSpeed::NUMBERS_LEN
    + MIDDLES.len()
    + MODES_MAX * (2 * KNOTS + 1);

impl Evidence {
    /// Spacing of the forecasts' steps.
    pub const fn step_ns(&self) -> u64 {
        self.step_ns.unsigned_abs()
    }

    /// Writes the learned state as numbers for [`Evidence::resume`], with the newest time first. Pending
    /// forecasts are left out.
    ///
    /// # Panics
    /// If `out` does not have [`NUMBERS_LEN`] places.
    pub fn write_numbers(&mut self, out: &mut [f64]) {
        assert_eq!(out.len(), NUMBERS_LEN, "a place per number");
        let [time, out @ ..] = out else { return };
        // Stored as bits: double precision can't represent all times.
        *time = f64::from_bits(self.now_ns.cast_unsigned());
        let mut places = out.iter_mut();
        self.numbers(&mut |number| {
            if let Some(place) = places.next() {
                *place = *number;
            }
        });
    }

    /// Resumes from earlier learned state under the same prior. All agents count as new.
    ///
    /// # Errors
    /// If the numbers are invalid; the state is then unchanged.
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

    /// Discounted number of matured forecasts, without the prior's.
    pub fn matured_count(&self) -> f64 {
        self.known.as_flattened().iter().map(|knowledge| knowledge.blend[KNOTS - 1].matured_count()).sum()
    }
}

impl Knowledge {
    /// Calls `each` with all learned numbers, to read or to change them.
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
