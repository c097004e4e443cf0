use wire::{Detection, Header};

use crate::{Audit, Finding, Place};

/// Identities that are followed at a time.
const IDENTITIES: usize = 2 * wire::DETECTIONS_MAX;
/// Frames after which doubts are looked for again.
const LOOK_FRAMES: u64 = 32;
/// Looks after which the figures begin again, so that a fault late in a long run still shows.
const LOOKS: u64 = 96;
/// A stamp this much before the newest one is of a clock that was set back.
const BACK_NS: i64 = 1_000_000_000;

/// The audit of a running producer: which doubts there were, as bits.
///
/// A doubt stays once it was found. The figures begin again every 3,072 frames.
#[derive(Clone, Debug)]
pub struct LiveAudit {
    audit: Audit,
    frames: u64,
    newest_ns: Option<i64>,
    doubts: u32,
    /// Doubts that were not reported yet.
    new: u32,
}

impl Default for LiveAudit {
    fn default() -> Self {
        Self { audit: Audit::new(IDENTITIES, None), frames: 0, newest_ns: None, doubts: 0, new: 0 }
    }
}

impl LiveAudit {
    /// Takes a frame; allocates nothing.
    pub fn frame(&mut self, header: &Header, detections: &[Detection]) {
        let place = Place { file: 0, line: header.seq };
        self.audit.frame();
        let is_back = self.newest_ns.is_some_and(|newest_ns| newest_ns - header.stamp_ns > BACK_NS);
        if is_back {
            self.audit.went_back(detections.len() as u64, place);
        }
        let newest_ns = self.newest_ns.filter(|_| !is_back).unwrap_or(header.stamp_ns);
        self.newest_ns = Some(newest_ns.max(header.stamp_ns));
        for detection in detections {
            self.audit.detection(header.stamp_ns.saturating_add(detection.offset_ns), detection, place);
        }
        self.frames += 1;
        if self.frames.is_multiple_of(LOOK_FRAMES) {
            self.look();
        }
    }

    fn look(&mut self) {
        let found = self.audit.doubts();
        self.new |= found & !self.doubts;
        self.doubts |= found;
        if self.new == 0 && self.frames.is_multiple_of(LOOK_FRAMES * LOOKS) {
            self.audit.restart();
        }
    }

    /// Bits of the doubts so far.
    #[must_use]
    pub const fn doubts(&self) -> u32 {
        self.doubts
    }

    /// The doubts that were found since this was called last. Allocates if there are any.
    pub fn take_new(&mut self) -> Vec<Finding> {
        let new = std::mem::take(&mut self.new);
        if new == 0 {
            return Vec::new();
        }
        let mut findings = self.audit.findings();
        findings.retain(|finding| finding.doubt.bit() & new != 0);
        findings
    }
}
