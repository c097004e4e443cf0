//! Out-of-sequence measurements (OOSM): a frame that arrives after newer ones is processed where its stamp
//! belongs, by rollback and replay.
//!
//! The [`ReplayBuffer`] holds the newest scans in the order of their stamps, and two *checkpoints* of the
//! estimates, [`LAG_MAX`] scans apart. An out-of-sequence scan is inserted by its stamp, the estimates are
//! rolled back to the checkpoint before it, and every scan since is replayed: the result is to the bit that
//! of the same frames and forecasts in sequence. While frames come in sequence, each costs one copy of it and
//! its forecasts, and every eighth one copy of the estimates.

use wire::{AgentType, Detection, Forecast, Header};

use crate::estimates::Estimates;
use crate::scan::Scan;

/// Most frames that may be newer than an out-of-sequence one.
pub const LAG_MAX: usize = 8;
/// Most scans held: those between the two checkpoints, and as many after the second.
const SCANS_MAX: usize = 2 * LAG_MAX;

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// One of the same stamp was processed.
    Repeated,
    /// Too many newer ones were processed, or far newer ones.
    TooLate,
}

/// The last scans, in the order of their stamps, and the estimates to replay them from, in memory that is
/// used again.
#[derive(Debug)]
pub struct ReplayBuffer {
    /// Those beyond `len` hold nothing but memory.
    scans: Vec<Scan>,
    len: usize,
    /// The estimates before the first scan.
    first: Estimates,
    /// The estimates before scan [`LAG_MAX`], where there is one.
    second: Estimates,
}

impl ReplayBuffer {
    /// A buffer without scans, whose first checkpoint has no estimates.
    #[must_use]
    pub fn new() -> Self {
        let scans = (0..SCANS_MAX).map(|_| Scan::new()).collect();
        Self { scans, len: 0, first: Estimates::default(), second: Estimates::default() }
    }

    /// Begins with these estimates instead of none, before any scan.
    pub fn begin_with(&mut self, estimates: &Estimates) {
        debug_assert_eq!(self.len, 0, "no scan has come yet");
        self.first.copy(estimates);
    }

    /// The scans held, oldest first.
    #[must_use]
    pub fn scans(&self) -> &[Scan] {
        &self.scans[..self.len]
    }

    /// The position of a frame with that stamp among the scans.
    ///
    /// # Errors
    /// [`Refusal`] where a scan of that stamp is held, more than [`LAG_MAX`] are newer, or one by more than
    /// `lag_max_ns`.
    pub fn position(&self, stamp_ns: i64, lag_max_ns: u64) -> Result<usize, Refusal> {
        let scans = self.scans();
        let position = scans.partition_point(|scan| scan.header.stamp_ns < stamp_ns);
        let lag_ns = scans.last().map_or(0, |newest| newest.header.stamp_ns.saturating_sub(stamp_ns));
        if scans.get(position).is_some_and(|scan| scan.header.stamp_ns == stamp_ns) {
            Err(Refusal::Repeated)
        } else if scans.len() - position > LAG_MAX || lag_ns.max(0).unsigned_abs() > lag_max_ns {
            Err(Refusal::TooLate)
        } else {
            Ok(position)
        }
    }

    /// Inserts a frame at its [position](ReplayBuffer::position); returns the position that it has now.
    pub fn insert(
        &mut self,
        mut position: usize,
        header: &Header,
        detections: (&[Detection], &[AgentType]),
        prior: Option<(&Header, &[Forecast])>,
    ) -> usize {
        if self.len == SCANS_MAX {
            // At most `LAG_MAX` are newer, so it lies behind the second checkpoint.
            self.scans.rotate_left(LAG_MAX);
            std::mem::swap(&mut self.first, &mut self.second);
            self.len -= LAG_MAX;
            position -= LAG_MAX;
        }
        self.scans[self.len].fill(header, detections, prior);
        self.len += 1;
        self.scans[position..self.len].rotate_right(1);
        position
    }

    /// Rolls the estimates back to a checkpoint before the scan at a position; returns the position of the
    /// first scan to replay.
    pub fn roll_back(&self, position: usize, estimates: &mut Estimates) -> usize {
        let (checkpoint, first) = if position < LAG_MAX { (&self.first, 0) } else { (&self.second, LAG_MAX) };
        estimates.copy(checkpoint);
        first
    }

    /// Copies the estimates before the scan at a position, where a checkpoint is due.
    pub fn checkpoint(&mut self, position: usize, estimates: &Estimates) {
        if position == LAG_MAX {
            self.second.copy(estimates);
        }
    }
}
