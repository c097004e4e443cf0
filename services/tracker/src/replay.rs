//! Out-of-sequence measurements (OOSM). A frame that arrives after newer ones is processed at its stamp, by
//! rollback and replay.
//!
//! The [`ReplayBuffer`] holds the newest scans in the order of their stamps, and two *checkpoints* of the
//! estimates, [`LAG_MAX`] scans apart:
//!
//! 1. An out-of-sequence scan is inserted by its stamp.
//! 2. The estimates are rolled back to the last checkpoint before the scan.
//! 3. Every scan since the checkpoint is replayed.
//!
//! The result equals, to the bit, the result of the same frames and forecasts in sequence. While frames
//! arrive in sequence, each costs one copy of the frame and its forecasts, and every eighth costs one copy of
//! the estimates.

use wire::{AgentType, Detection, Forecast, Header};

use crate::estimates::Estimates;
use crate::options::TrackerOptions;
use crate::scan::Scan;

/// Largest number of frames that may be newer than an out-of-sequence frame.
pub const LAG_MAX: usize = 8;
/// Largest number of scans held: the scans between the two checkpoints, and as many after the second.
const SCANS_MAX: usize = 2 * LAG_MAX;

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// A frame with the same stamp was processed.
    Repeated,
    /// Too many newer frames were processed, or much newer ones.
    TooLate,
}

/// The last scans in the order of their stamps, and the estimates from which they can be replayed. The memory
/// is reused.
#[derive(Debug)]
pub struct ReplayBuffer {
    /// Scans beyond `len` only keep their memory.
    scans: Vec<Scan>,
    len: usize,
    /// The estimates before the first scan.
    first: Estimates,
    /// The estimates before scan [`LAG_MAX`], if there is such a scan.
    second: Estimates,
}

impl ReplayBuffer {
    /// A buffer without scans, whose first checkpoint has no estimates.
    #[must_use]
    pub fn new(options: &TrackerOptions) -> Self {
        let scans = (0..SCANS_MAX).map(|_| Scan::new()).collect();
        let [first, second] = [(); 2].map(|()| Estimates::new(options, 0));
        Self { scans, len: 0, first, second }
    }

    /// Begins with these estimates instead of none, before any scan.
    pub fn begin_with(&mut self, estimates: &Estimates) {
        debug_assert_eq!(self.len, 0, "no scan has come yet");
        self.first.copy(estimates);
    }

    /// Forgets the scans, and begins again with these estimates.
    pub fn restart(&mut self, estimates: &Estimates) {
        self.len = 0;
        self.begin_with(estimates);
    }

    /// The scans held, oldest first.
    #[must_use]
    pub fn scans(&self) -> &[Scan] {
        &self.scans[..self.len]
    }

    /// Whether a scan with this stamp and these detections is held: the frame was sent twice.
    #[must_use]
    pub fn has(&self, stamp_ns: i64, detections: &[Detection]) -> bool {
        let bytes = bytemuck::cast_slice::<Detection, u8>;
        let mut same = self.scans().iter().filter(|scan| scan.header.stamp_ns == stamp_ns);
        same.any(|scan| bytes(&scan.detections) == bytes(detections))
    }

    /// The position of a frame with this stamp among the scans.
    ///
    /// # Errors
    /// [`Refusal`] if a scan with this stamp is held, more than [`LAG_MAX`] scans are newer, or one is newer
    /// by more than `lag_max_ns`.
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

    /// Inserts a frame at its [position](ReplayBuffer::position). Returns its resulting position.
    pub fn insert(
        &mut self,
        mut position: usize,
        header: &Header,
        detections: (&[Detection], &[AgentType]),
        prior: Option<(&Header, &[Forecast])>,
    ) -> usize {
        if self.len == SCANS_MAX {
            // At most `LAG_MAX` scans are newer, so the frame is after the second checkpoint.
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

    /// Rolls the estimates back to a checkpoint before the scan at a position. Returns the position of the
    /// first scan to replay.
    pub fn roll_back(&self, position: usize, estimates: &mut Estimates) -> usize {
        let (checkpoint, first) = if position < LAG_MAX { (&self.first, 0) } else { (&self.second, LAG_MAX) };
        estimates.copy(checkpoint);
        first
    }

    /// Copies the estimates before the scan at a position, if a checkpoint is due.
    pub fn checkpoint(&mut self, position: usize, estimates: &Estimates) {
        if position == LAG_MAX {
            self.second.copy(estimates);
        }
    }
}
