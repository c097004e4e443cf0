//! The last frames, and what was believed before them: a frame that comes late is taken in where it belongs.
//!
//! A *scan* is a frame with all that came with it. The newest lie in a ring in the order of their stamps, between two
//! *checkpoints* of the estimates, [`LATE_MAX`] scans apart. For a late frame the estimates go back to a checkpoint before
//! it, and every scan since is taken in again: what comes of it is to the bit what would have come of the same
//! frames and forecasts in order.
//! While frames come in order that costs copying each with its forecasts, and the estimates once in eight.

use bytemuck::Zeroable;
use wire::{AgentType, Detection, Forecast, Header};

use crate::estimates::Estimates;

/// Most frames that may be newer than one that comes late.
pub const LATE_MAX: usize = 8;
/// Most scans kept: those between two checkpoints, and as many after the second.
const SCANS_MAX: usize = 2 * LATE_MAX;

/// A frame, and the forecasts at hand when it came.
#[derive(Clone, Debug)]
pub struct Scan {
    /// The frame's header.
    pub header: Header,
    /// The frame.
    pub detections: Vec<Detection>,
    /// The types of the detections.
    pub types: Vec<AgentType>,
    /// Header of the forecasts, where there were any.
    pub prior: Option<Header>,
    /// The forecasts.
    pub forecasts: Vec<Forecast>,
}

/// Why a frame is not taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unplaced {
    /// One of the same stamp was.
    Repeated,
    /// Too many newer ones were, or far newer ones.
    TooLate,
}

/// The last scans, in the order of their stamps, in memory that is used again.
#[derive(Debug)]
pub struct Scans {
    /// Those beyond `len` hold nothing but memory.
    scans: Vec<Scan>,
    len: usize,
    /// The estimates before the first scan.
    first: Estimates,
    /// The estimates before scan [`LATE_MAX`], where there is one.
    second: Estimates,
}

impl Scan {
    fn new() -> Self {
        let (detections, types, forecasts) = (Vec::new(), Vec::new(), Vec::new());
        Self { header: Header::zeroed(), detections, types, prior: None, forecasts }
    }

    fn fill(
        &mut self,
        header: &Header,
        (detections, types): (&[Detection], &[AgentType]),
        prior: Option<(&Header, &[Forecast])>,
    ) {
        self.header = *header;
        self.detections.clear();
        self.detections.extend_from_slice(detections);
        self.types.clear();
        self.types.extend_from_slice(types);
        self.prior = prior.map(|(header, _)| *header);
        self.forecasts.clear();
        self.forecasts.extend_from_slice(prior.map_or(&[], |(_, forecasts)| forecasts));
    }
}

impl Scans {
    /// No scan, before which nothing was believed.
    #[must_use]
    pub fn new() -> Self {
        let scans = (0..SCANS_MAX).map(|_| Scan::new()).collect();
        Self { scans, len: 0, first: Estimates::default(), second: Estimates::default() }
    }

    /// The scans that are kept.
    #[must_use]
    pub fn kept(&self) -> &[Scan] {
        &self.scans[..self.len]
    }

    /// Where a frame of that stamp belongs among them.
    ///
    /// # Errors
    /// [`Unplaced`] where one of that stamp is kept, more than [`LATE_MAX`] are newer, or one by more than `late_max_ns`.
    pub fn place(&self, stamp_ns: i64, late_max_ns: u64) -> Result<usize, Unplaced> {
        let kept = self.kept();
        let place = kept.partition_point(|scan| scan.header.stamp_ns < stamp_ns);
        let late_ns = kept.last().map_or(0, |newest| newest.header.stamp_ns.saturating_sub(stamp_ns));
        if kept.get(place).is_some_and(|scan| scan.header.stamp_ns == stamp_ns) {
            Err(Unplaced::Repeated)
        } else if kept.len() - place > LATE_MAX || late_ns.max(0).unsigned_abs() > late_max_ns {
            Err(Unplaced::TooLate)
        } else {
            Ok(place)
        }
    }

    /// Keeps a frame at a [place](Scans::place); returns the place that it has now.
    pub fn insert(
        &mut self,
        mut place: usize,
        header: &Header,
        detections: (&[Detection], &[AgentType]),
        prior: Option<(&Header, &[Forecast])>,
    ) -> usize {
        if self.len == SCANS_MAX {
            // At most `LATE_MAX` are newer, so it lies behind the second checkpoint.
            self.scans.rotate_left(LATE_MAX);
            std::mem::swap(&mut self.first, &mut self.second);
            self.len -= LATE_MAX;
            place -= LATE_MAX;
        }
        self.scans[self.len].fill(header, detections, prior);
        self.len += 1;
        self.scans[place..self.len].rotate_right(1);
        place
    }

    /// Takes the estimates back to a checkpoint before a scan that was inserted late; returns the place of the first scan
    /// that is to be taken in again.
    pub fn go_back(&self, place: usize, estimates: &mut Estimates) -> usize {
        let (checkpoint, at) = if place < LATE_MAX { (&self.first, 0) } else { (&self.second, LATE_MAX) };
        estimates.copy(checkpoint);
        at
    }

    /// Keeps the estimates before the scan at that place, where a checkpoint is due.
    pub fn keep(&mut self, place: usize, estimates: &Estimates) {
        if place == LATE_MAX {
            self.second.copy(estimates);
        }
    }
}
