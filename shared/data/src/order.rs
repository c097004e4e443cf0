//! Time that runs backwards within an identity.
//!
//! Rows can be in any order: by time, by track, shuffled. So a row that is earlier than the previous row of
//! its identity is not an error by itself. In a shuffled file, half of all rows are. In a file that is
//! otherwise in order, such a row shows that the clock was set back or the recording was played twice. Later
//! rows would be mixed with rows of another time.

use std::collections::HashMap;

use wire::{OFFSET_MAX_NS, detection_flags};

use crate::ReadError;
use crate::row::Row;

/// If at most this share of the rows goes back, the file counts as in order: 1 / 8.
const IN_ORDER: usize = 8;
/// Number of rows of a type that go back if a clock was set. If more go back, the rows of a sweep are in no order.
const STEPS_MAX: usize = 2;
/// Shortest step of a clock that is found without identities.
const STEP_MIN_NS: i64 = 150_000_000;

/// The owner of a row's time: an identity, or all agents of a type without identities.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Whose {
    Id(u64),
    Type(u32),
}

/// Refuses rows in file order whose time goes back within an identity although the file is in order
/// otherwise. Without identities, rows of a sweep can be in any order. So time may go back by up to a second,
/// or by a tenth of the recording if that is less. If it goes back once or twice only, more than 0.15 s are too much.
pub(crate) fn check(rows: &[Row<'_>]) -> Result<(), ReadError> {
    let span_ns = |rows: &[Row<'_>]| {
        let stamps_ns = || rows.iter().map(|row| row.stamp_ns);
        Some(stamps_ns().max()? - stamps_ns().min()?)
    };
    let sweep_max_ns = (span_ns(rows).unwrap_or(0) / 10).min(OFFSET_MAX_NS as i64);
    let by_sweep = Backwards::find(rows, sweep_max_ns);
    let first = match by_sweep.first.filter(|_| by_sweep.back * IN_ORDER <= by_sweep.pairs) {
        None => {
            let steps = Backwards::find(rows, 0);
            steps.first.filter(|(before, row)| {
                steps.back <= STEPS_MAX * steps.types && before.stamp_ns - row.stamp_ns > STEP_MIN_NS
            })
        }
        first => first,
    };
    match first {
        None => Ok(()),
        Some((before, row)) => Err(ReadError::TimeGoesBack {
            path: row.path.to_owned(),
            line: row.line,
            id: row.detection.has(detection_flags::HAS_ID).then_some(row.detection.id),
            stamp_s: row.stamp_ns as f64 * 1e-9,
            before_line: before.line,
            before_s: before.stamp_ns as f64 * 1e-9,
        }),
    }
}

/// The rows whose time goes back.
struct Backwards<'a> {
    /// Number of owners.
    types: usize,
    /// Number of rows with an earlier row of the same owner.
    pairs: usize,
    back: usize,
    /// The first row that goes back and is followed by others, and the row before it.
    first: Option<(&'a Row<'a>, &'a Row<'a>)>,
}

impl<'a> Backwards<'a> {
    /// Rows without identities may go back by the tolerance.
    fn find(rows: &'a [Row<'a>], tolerance_ns: i64) -> Self {
        // The newest row, and the previous row if time went back between them.
        let mut newest: HashMap<Whose, (&Row<'_>, Option<&Row<'_>>)> = HashMap::new();
        let (mut pairs, mut back, mut first) = (0_usize, 0_usize, None);
        for row in rows {
            let (whose, tolerance_ns) = match row.detection.has(detection_flags::HAS_ID) {
                true => (Whose::Id(row.detection.id), 0),
                false => (Whose::Type(row.detection.agent_type), tolerance_ns),
            };
            let last = newest.get(&whose).copied();
            pairs += usize::from(last.is_some());
            let goes_back = last.filter(|(before, _)| row.stamp_ns < before.stamp_ns - tolerance_ns);
            back += usize::from(goes_back.is_some());
            // A single late row is in its place after sorting. If time continues from there, it is another time.
            let continues =
                |before: &Row<'_>| matches!(whose, Whose::Id(_)) || row.stamp_ns < before.stamp_ns;
            let late = last.and_then(|(late, before)| Some((before.filter(|row| continues(row))?, late)));
            first = first.or(late);
            newest.insert(whose, (row, goes_back.map(|(before, _)| before)));
        }
        Self { types: newest.len(), pairs, back, first }
    }
}
