//! The clock of the stamps: late frames, and a clock that was set.
//!
//! A stamp that goes back is either late or from a clock that was set back. Both look the same in the first
//! frame. A late frame fills a gap, or the newest stamp continues after it. So [`Clock`] decides by what
//! follows:
//!
//! 1. A frame is *behind* if its stamp is not newer than the newest one.
//! 2. A frame behind is *covered* if it is too late to be used, or if it lies where the frames are already as
//!    dense as usual.
//! 3. The clock was set back if [`COVERED_MAX`] frames in a row are behind and covered, each with a later stamp
//!    than the one before. Frames that fill gaps can be more, at most [`LATE_MAX`].
//!    With [several senders](Clock::of_several), the row must be longer than 1.5 intervals, because a slower or
//!    delayed sender may be behind the others for as long as they send nothing.
//! 4. Frames that follow each other much faster than their stamps come from a queue. They are late.
//!
//! A stamp that is ahead by more than the horizon needs no second frame: the tracks have ended anyway.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Number of frames behind, in a row and covered, that show a clock that was set back.
const COVERED_MAX: u32 = 2;
/// Largest number of late frames in a row.
const LATE_MAX: u32 = 8;
/// Number of stamps that are remembered.
const STAMPS_MAX: usize = 16;

/// The relation of a frame's stamp to the earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stamped {
    /// Newer than all others.
    Newer,
    /// Not newer, as far as is known.
    Late,
    /// The first of a session: the clock was set by this time. It is negative if the clock was set back.
    Set {
        /// The difference to the expected stamp.
        by_ns: i64,
    },
}

/// A clock that was set: a session begins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockSet {
    /// The first tick of the session.
    pub tick: u64,
    /// The difference to the expected stamp, negative if the clock was set back.
    pub by_s: f64,
}

impl ClockSet {
    /// The difference in nanoseconds, at a tick.
    #[must_use]
    pub fn new(tick: u64, by_ns: i64) -> Self {
        Self { tick, by_s: (by_ns as f64 / 1e6).round() / 1e3 }
    }

    /// Whether the clock was set back.
    #[must_use]
    pub fn is_back(&self) -> bool {
        self.by_s < 0.0
    }
}

impl fmt::Display for ClockSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verb = if self.is_back() { "go back" } else { "jump forward" };
        write!(f, "the stamps {verb} by {:.2} s at tick {}", self.by_s.abs(), self.tick)
    }
}

/// A frame, as far as its clock is concerned.
#[derive(Clone, Copy, Debug)]
pub struct StampedFrame {
    /// The stamp.
    pub stamp_ns: i64,
    /// The planned interval between frames, or 0.
    pub interval_ns: u64,
    /// When the frame was released, on `CLOCK_MONOTONIC`. `None` if frames do not follow real time.
    pub released_ns: Option<u64>,
    /// Whether the frame repeats the content of an earlier one: it was sent twice.
    pub is_repeated: bool,
}

/// Decides whether the clock of the stamps was set: a frame that is not newer is late until more frames show that
/// the clock goes on there.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    /// A frame that is late by more is not used. A stamp that is ahead by more begins a session.
    horizon_ns: u64,
    has_several: bool,
    /// The newest stamps, sorted.
    stamps: [i64; STAMPS_MAX],
    len: usize,
    behind: Option<Behind>,
}

/// Frames behind, in a row.
#[derive(Clone, Copy, Debug)]
struct Behind {
    first_ns: i64,
    last_ns: i64,
    released_ns: Option<u64>,
    frames: u32,
    covered: u32,
}

impl Clock {
    /// A clock without stamps.
    #[must_use]
    pub const fn new(horizon_ns: u64) -> Self {
        Self { horizon_ns, has_several: false, stamps: [0; STAMPS_MAX], len: 0, behind: None }
    }

    /// A clock without stamps, for frames that several senders send independently.
    #[must_use]
    pub const fn of_several(horizon_ns: u64) -> Self {
        Self { has_several: true, ..Self::new(horizon_ns) }
    }

    /// Begins a session with this stamp. Returns the difference to the expected stamp.
    pub fn restart(&mut self, stamp_ns: i64, interval_ns: u64) -> i64 {
        let interval_ns = self.interval_ns(interval_ns).cast_signed();
        let expected_ns = self.stamps().last().map_or(stamp_ns, |newest| newest.saturating_add(interval_ns));
        (self.len, self.behind) = (0, None);
        self.insert(stamp_ns);
        stamp_ns.saturating_sub(expected_ns)
    }

    /// Adds a frame.
    pub fn add(&mut self, frame: StampedFrame) -> Stamped {
        let stamp_ns = frame.stamp_ns;
        let Some(&newest_ns) = self.stamps().last() else {
            self.insert(stamp_ns);
            return Stamped::Newer;
        };
        if stamp_ns > newest_ns {
            self.behind = None;
            if stamp_ns.abs_diff(newest_ns) > self.horizon_ns {
                return Stamped::Set { by_ns: self.restart(stamp_ns, frame.interval_ns) };
            }
            self.insert(stamp_ns);
            return Stamped::Newer;
        }
        if frame.is_repeated {
            return Stamped::Late;
        }
        let covered = u32::from(self.is_covered(&frame));
        let mut behind = Behind {
            first_ns: stamp_ns,
            last_ns: stamp_ns,
            released_ns: frame.released_ns,
            frames: 1,
            covered,
        };
        if let Some(before) = self.behind.filter(|before| before.is_continued_by(&frame)) {
            behind.first_ns = before.first_ns;
            behind.frames += before.frames;
            behind.covered = if covered > 0 { before.covered + 1 } else { 0 };
        }
        let since_first_ns = stamp_ns.saturating_sub(behind.first_ns);
        let interval_ns = self.interval_ns(frame.interval_ns);
        let is_long = !self.has_several || since_first_ns.unsigned_abs() > interval_ns + interval_ns / 2;
        if is_long && (behind.covered >= COVERED_MAX || behind.frames > LATE_MAX) {
            let by_ns = self.restart(stamp_ns, frame.interval_ns);
            return Stamped::Set { by_ns: by_ns.saturating_sub(since_first_ns) };
        }
        self.behind = Some(behind);
        if covered == 0 {
            self.insert(stamp_ns);
        }
        Stamped::Late
    }

    fn stamps(&self) -> &[i64] {
        &self.stamps[..self.len]
    }

    fn insert(&mut self, stamp_ns: i64) {
        let place = self.stamps().partition_point(|other| *other < stamp_ns);
        if self.len < STAMPS_MAX {
            self.len += 1;
            self.stamps[place..self.len].rotate_right(1);
            self.stamps[place] = stamp_ns;
        } else if let Some(before) = place.checked_sub(1) {
            self.stamps[..place].rotate_left(1);
            self.stamps[before] = stamp_ns;
        }
    }

    /// Whether a frame behind adds nothing: it is too late, or the frames around it are dense.
    fn is_covered(&self, frame: &StampedFrame) -> bool {
        let stamps = self.stamps();
        let place = stamps.partition_point(|other| *other < frame.stamp_ns);
        let newest_ns = stamps.last().copied().unwrap_or(frame.stamp_ns);
        let late_ns = newest_ns.saturating_sub(frame.stamp_ns).unsigned_abs();
        if stamps.len() - place > LATE_MAX as usize || late_ns > self.horizon_ns {
            return true;
        }
        let Some(next_ns) = stamps.get(place) else { return false };
        let Some(previous_ns) = place.checked_sub(1).and_then(|place| stamps.get(place)) else {
            return *next_ns == frame.stamp_ns;
        };
        let interval_ns = self.interval_ns(frame.interval_ns);
        *next_ns == frame.stamp_ns || next_ns.abs_diff(*previous_ns) < interval_ns + interval_ns / 2
    }

    /// The interval of the frames: their median, or the planned one if it is longer.
    fn interval_ns(&self, planned_ns: u64) -> u64 {
        let mut between = [0; STAMPS_MAX];
        let pairs = self.stamps().windows(2).map(|pair| pair[1].abs_diff(pair[0]));
        let count = between.iter_mut().zip(pairs).map(|(place, ns)| *place = ns).count();
        let between = &mut between[..count];
        between.sort_unstable();
        planned_ns.max(between.get(count / 2).copied().unwrap_or(0))
    }
}

impl Behind {
    /// Whether a frame continues the row on the same clock.
    fn is_continued_by(&self, frame: &StampedFrame) -> bool {
        let apart_ns = frame.stamp_ns.saturating_sub(self.last_ns);
        let is_from_queue = self.released_ns.zip(frame.released_ns).is_some_and(|(before_ns, now_ns)| {
            now_ns.saturating_sub(before_ns) < apart_ns.unsigned_abs() / 4
        });
        apart_ns > 0 && !is_from_queue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TENTH_NS: i64 = 100_000_000;
    const HORIZON_NS: u64 = 4_800_000_000;

    /// The relations of frames with these stamps, in tenths of a second, that are sent in real time.
    fn live(stamps: impl IntoIterator<Item = f64>) -> Vec<Stamped> {
        let stamps = stamps.into_iter().enumerate();
        with(stamps.map(|(nth, stamp)| (stamp, Some(nth as u64 * TENTH_NS as u64))))
    }

    fn with(frames: impl IntoIterator<Item = (f64, Option<u64>)>) -> Vec<Stamped> {
        let mut clock = Clock::new(HORIZON_NS);
        let mut add = |(stamp, released_ns)| {
            let stamp_ns = (stamp * TENTH_NS as f64) as i64;
            clock.add(StampedFrame { stamp_ns, interval_ns: 0, released_ns, is_repeated: false })
        };
        frames.into_iter().map(&mut add).collect()
    }

    fn sets(stamped: &[Stamped]) -> Vec<(usize, f64)> {
        let set = |(nth, stamped): (usize, &Stamped)| match stamped {
            Stamped::Set { by_ns } => Some((nth, *by_ns as f64 / TENTH_NS as f64)),
            _ => None,
        };
        stamped.iter().enumerate().filter_map(set).collect()
    }

    fn range(from: u32, to: u32) -> impl Iterator<Item = f64> + Clone {
        (from..to).map(f64::from)
    }

    #[test]
    fn a_clock_that_is_set_back_begins_a_session_with_the_second_frame() {
        for back in [2.0, 2.5, 5.0, 9.9, 30.0, 400.0] {
            let stamps = range(100, 180).map(|stamp| if stamp < 160.0 { stamp } else { stamp - back });
            assert_eq!(sets(&live(stamps.clone())), [(61, -back)], "{back}");
            // Frames that do not follow real time.
            let stamped = with(stamps.map(|stamp| (stamp, None)));
            assert_eq!(sets(&stamped), [(61, -back)], "{back}");
        }
    }

    #[test]
    fn a_loop_begins_a_session_in_every_round() {
        let rounds = (0..4).flat_map(|_| range(0, 20));
        assert_eq!(sets(&live(rounds)), [(21, -20.0), (41, -20.0), (61, -20.0)]);
    }

    #[test]
    fn a_clock_that_is_set_beyond_the_horizon_begins_a_session_at_once() {
        let ahead = |by| sets(&live(range(0, 20).chain(range(20, 30).map(move |stamp| stamp + by))));
        assert_eq!(ahead(40.0), []);
        assert_eq!(ahead(100.0), [(20, 100.0)]);
    }

    #[test]
    fn late_frames_begin_no_session() {
        // Single ones, neighbours in reverse, and a queue that fills a gap.
        let order = [1, 2, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 13, 19, 14, 15, 16, 17, 18, 20, 22, 21, 23];
        assert_eq!(sets(&live(order.map(f64::from))), []);
        // Another sensor, 2.5 frames late, each frame between two of the first one.
        let sensors = range(0, 40).flat_map(|stamp| [stamp, stamp - 2.5]);
        assert_eq!(sets(&live(sensors)), []);
        // And its frames from a queue.
        let queued = (0..8).flat_map(|round| {
            let first_ns = round * 4 * TENTH_NS as u64;
            let stamps = (0..4).map(move |nth| (round * 4 + nth) as f64);
            let in_time = stamps.clone().map(move |stamp| (stamp, stamp as u64 * TENTH_NS as u64));
            let sent_ns = first_ns + 3 * TENTH_NS as u64;
            let from_queue = stamps.enumerate().map(move |(nth, stamp)| (stamp - 0.5, sent_ns + nth as u64));
            in_time.chain(from_queue).map(|(stamp, ns)| (stamp, Some(ns)))
        });
        assert_eq!(sets(&with(queued)), []);
    }

    #[test]
    fn a_delayed_sender_of_several_begins_no_session() {
        let mut clock = Clock::of_several(HORIZON_NS);
        let mut add = |stamp: f64, now: f64| {
            let [stamp_ns, now_ns] = [stamp, now].map(|time| (time * TENTH_NS as f64) as i64);
            let released_ns = Some(now_ns as u64);
            clock.add(StampedFrame { stamp_ns, interval_ns: 0, released_ns, is_repeated: false })
        };
        for tick in range(10, 60) {
            assert_eq!(add(tick, tick), Stamped::Newer);
            assert_eq!([add(tick - 2.0, tick + 0.1), add(tick - 1.5, tick + 0.6)], [Stamped::Late; 2]);
        }
        let back: Vec<Stamped> = range(60, 66).map(|tick| add(tick - 6.0, tick)).collect();
        assert_eq!(sets(&back), [(2, -6.0)]);
    }

    #[test]
    fn a_sensor_with_a_clock_far_behind_begins_no_session() {
        let sensors = range(400, 440).flat_map(|stamp| [stamp, stamp - 180.0]);
        assert_eq!(sets(&live(sensors)), []);
    }

    #[test]
    fn frames_that_were_sent_twice_begin_no_session() {
        let mut clock = Clock::new(HORIZON_NS);
        let mut add = |stamp_ns, is_repeated| {
            clock.add(StampedFrame { stamp_ns, interval_ns: 1, released_ns: None, is_repeated })
        };
        (0..20).for_each(|stamp_ns| assert_eq!(add(stamp_ns, false), Stamped::Newer));
        (15..20).for_each(|stamp_ns| assert_eq!(add(stamp_ns, true), Stamped::Late));
        assert_eq!(add(20, false), Stamped::Newer);
    }
}
