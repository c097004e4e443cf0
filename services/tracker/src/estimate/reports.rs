//! Repeated measurements: a detector that is slower than the frames often resends its detections (sample and
//! hold).
//!
//! Two measurements of a moving agent always differ somewhere. A detection that equals its track's last one
//! bit by bit, while the track moves, is therefore not a measurement.

use wire::{AgentType, Detection};

use crate::observation::Found;

/// Without a new report for this time or the detector's own period, a repetition counts as a measurement: the
/// agent rests.
const HOLD_MAX_NS: u64 = 350_000_000;
/// Share of the detector's period after which the next measurement may be due.
const PERIOD_SHARE: f64 = 0.9;
/// Speed and braking, by type. A faster agent cannot have stopped since the previous detection.
const STOPPING: [(f64, f64); 3] = [(1.0, 6.0), (0.7, 4.0), (0.5, 3.0)];

/// The report of a detection, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reported([u32; 6]);

impl Reported {
    /// The report of a detection.
    #[must_use]
    pub const fn new(detection: &Detection) -> Self {
        let &Detection { x_m, y_m, heading_rad, speed_mps, length_m, width_m, .. } = detection;
        Self([
            x_m.to_bits(),
            y_m.to_bits(),
            heading_rad.to_bits(),
            speed_mps.to_bits(),
            length_m.to_bits(),
            width_m.to_bits(),
        ])
    }

    /// The bits of the position.
    #[must_use]
    pub const fn place(&self) -> [u32; 2] {
        [self.0[0], self.0[1]]
    }

    /// The position.
    #[must_use]
    pub fn position_m(&self) -> [f64; 2] {
        self.place().map(|bits| f64::from(f32::from_bits(bits)))
    }
}

/// The newest report of an agent.
#[derive(Clone, Copy, Debug)]
pub struct Reports {
    pub last: Reported,
    /// Own time of the first detection with this report.
    pub fresh_ns: i64,
    /// Time from the previous report to this one; 0 if there was none.
    period_ns: u64,
    /// Whether all reports had the same position.
    pub stands: bool,
}

impl Reports {
    /// The first report.
    pub const fn new(found: &Found<'_>) -> Self {
        let last = Reported::new(found.detection);
        Self { last, fresh_ns: found.own_ns, period_ns: 0, stands: true }
    }

    /// Adds the report of a measurement.
    pub fn add(&mut self, found: &Found<'_>) {
        let reported = Reported::new(found.detection);
        if reported != self.last {
            let period_ns = found.own_ns.saturating_sub(self.fresh_ns).max(0).unsigned_abs();
            let stands = self.stands && reported.place() == self.last.place();
            *self = Self { last: reported, fresh_ns: found.own_ns, period_ns, stands };
        }
    }

    /// Whether the detector's next measurement is not due yet.
    pub fn is_early(&self, age_ns: u64) -> bool {
        (age_ns as f64) < PERIOD_SHARE * self.period_ns as f64
    }

    /// Whether a detection with the same report is only resent. `speed_mps` is the agent's speed, if it is
    /// known.
    pub fn is_resent(&self, own_ns: i64, agent_type: AgentType, speed_mps: Option<f64>) -> bool {
        let age_ns = own_ns.saturating_sub(self.fresh_ns).max(0).unsigned_abs();
        if age_ns > HOLD_MAX_NS.max(self.period_ns) {
            return false;
        }
        let Some(speed_mps) = speed_mps else { return true };
        let (least_mps, braking_mps2) = STOPPING[agent_type.index()];
        let since_ns = if self.period_ns > 0 { self.period_ns } else { age_ns };
        self.is_early(age_ns) || speed_mps > least_mps + braking_mps2 * since_ns as f64 / 1e9
    }
}
