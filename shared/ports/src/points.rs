//! Points in a stage's step at which the stage kills itself, to test the consequences of a death there.
//!
//! The points are always compiled in. A disarmed point costs one branch on a byte. [`POINTS_VARIABLE`] arms
//! points and is read once, when the stage opens. It is a list of `stage:point@tick`, as in
//! `decoder:mid-write@40,decoder:idle@80`. The n-th entry of a stage is for its n-th process.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering::Relaxed};

use rustix::process::{Signal, getpid, kill_process};
use wire::{Header, StageId};

/// The environment variable that arms points in the stages' steps.
pub const POINTS_VARIABLE: &str = "STGDAT_FAULT_POINTS";

wire::named! {
    /// A point in a stage's step.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[repr(u8)]
    pub enum Point {
        /// The tick's output has no memory yet.
        BeforeLoan = 1 => "before-loan",
        /// The payload is written into the loan, the header is not.
        MidWrite = 2 => "mid-write",
        /// The frame is sent, its readers are not woken.
        BeforeNotify = 3 => "before-notify",
        /// The frame is sent, its readers are woken.
        AfterSend = 4 => "after-send",
        /// The stage sleeps until the next tick.
        Idle = 5 => "idle",
    }
}

/// The armed point as a number; 0 if none is armed.
static ARMED: AtomicU8 = AtomicU8::new(0);
/// The first tick at which the point kills.
static TICK: AtomicU64 = AtomicU64::new(0);
/// The tick after the newest one that was sent or finished; 0 before the first.
static NEXT: AtomicU64 = AtomicU64::new(0);

impl Point {
    /// The point of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|point| point.name() == name)
    }
}

/// Arms the point of this process's stage, if the variable has one.
pub(crate) fn arm(stage: StageId, incarnation: u32) {
    let entry = std::env::var(POINTS_VARIABLE).ok().and_then(|list| entry(&list, stage, incarnation));
    if let Some((point, tick)) = entry {
        TICK.store(tick, Relaxed);
        ARMED.store(point as u8, Relaxed);
    }
}

/// The point of a process of a stage, and the first tick at which it kills.
fn entry(list: &str, stage: StageId, incarnation: u32) -> Option<(Point, u64)> {
    let of_stage = list.split(',').filter_map(|entry| entry.trim().split_once(':'));
    let (_, at) = of_stage.filter(|(name, _)| *name == stage.name()).nth(incarnation as usize)?;
    let (point, tick) = at.split_once('@')?;
    Some((Point::from_name(point)?, tick.parse().ok()?))
}

/// Called when the stage sends a frame and has reached `point`.
#[inline]
pub(crate) fn sending(point: Point, header: &Header) {
    if ARMED.load(Relaxed) != 0 && header.is_tick() {
        if point == Point::AfterSend {
            NEXT.store(header.seq + 1, Relaxed);
        }
        die_if_due(point, header.seq);
    }
}

/// Called when the stage reaches a point before it has the next frame. The point counts for the next tick,
/// except [`Point::Idle`], which counts for the finished one.
#[inline]
pub(crate) fn reach(point: Point) {
    if ARMED.load(Relaxed) != 0 {
        let next = NEXT.load(Relaxed);
        match point {
            // Nothing has been sent: the stages are still being linked.
            _ if next == 0 => {}
            Point::Idle => die_if_due(point, next - 1),
            _ => die_if_due(point, next),
        }
    }
}

/// Called when the stage has finished a tick, whether it sends anything or not.
#[inline]
pub(crate) fn finished(seq: u64) {
    if ARMED.load(Relaxed) != 0 {
        NEXT.store(seq + 1, Relaxed);
    }
}

fn die_if_due(point: Point, tick: u64) {
    if ARMED.load(Relaxed) == point as u8 && tick >= TICK.load(Relaxed) {
        // Not refused: a process may kill itself.
        let _ = kill_process(getpid(), Signal::KILL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nth_entry_of_a_stage_is_for_its_nth_process() {
        let list =
            "decoder:mid-write@40, sampler:idle@7,decoder:before-loan@80,tracker:nowhere@1,source:idle@x";
        assert_eq!(entry(list, StageId::Decoder, 0), Some((Point::MidWrite, 40)));
        assert_eq!(entry(list, StageId::Decoder, 1), Some((Point::BeforeLoan, 80)));
        assert_eq!(entry(list, StageId::Sampler, 0), Some((Point::Idle, 7)));
        for (stage, incarnation) in
            [(StageId::Decoder, 2), (StageId::Encoder, 0), (StageId::Tracker, 0), (StageId::Source, 0)]
        {
            assert_eq!(entry(list, stage, incarnation), None, "{stage:?}");
        }
    }

    #[test]
    fn points_have_names_that_read_back() {
        for point in Point::ALL {
            assert_eq!(Point::from_name(point.name()), Some(point));
        }
        assert_eq!(Point::from_name("nowhere"), None);
    }
}
