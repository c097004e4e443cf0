//! Whether an agent's positions confirm the speeds and headings of its detections.
//!
//! A *chord* leads from one position to another at least [`CHORD_NS`] later. The reports along it describe a way
//! too: ∫ v (cos ψ, sin ψ) dt. If the two ways have other lengths or opposite directions, and noise and delays do not
//! explain it, the positions decide. The tracker then ignores the speeds, or the headings if their axis is wrong, until
//! later chords confirm them. Detectors send 0 for what they do not know, other units, or headings of the rear.

use std::f64::consts::{FRAC_PI_2, PI, SQRT_2};

use filters::{Filter, FilterFault, Observation, wrapped};
use kinematics::hypot;
use wire::{Detection, detection_flags};

use super::Estimate;
use super::kind::{UNKNOWN, kind};
use crate::belief::Belief;
use crate::front::{Front, folded, is_reversed};
use crate::observation::Found;
use crate::options::{InputModel, TrackerOptions};
use crate::steady::Steady;

/// Shortest time of a chord, and the longest one of a chord that is too short to contradict anything.
const CHORD_NS: i64 = 600_000_000;
const CHORD_MAX_NS: i64 = 3_000_000_000;
/// A longer time between two reports ends a chord.
const GAP_MAX_NS: i64 = 2_100_000_000;
/// Differences of two ways that delays and changes of the speed explain: a part of the longer way, and a constant.
const WAY_SHARE: f64 = 0.4;
const WAY_M: f64 = 0.3;
/// Differences up to this number of standard deviations are noise.
const SIGMAS: f64 = 4.0;
/// Deviation of the velocity at the end of a chord from the mean velocity along it.
const CHANGE_MPS: f64 = 0.3;
/// Largest angle between the axis of a vehicle's headings and its chord, and between two chords of a vehicle that drives
/// straight. In a slow or tight turn, the centre of a box moves in another direction than its heading.
const AXIS_RAD: f64 = 0.35;
const STRAIGHT_RAD: f64 = 0.1;
const STRAIGHT_MPS: f64 = 5.0;
/// Shorter ways confirm nothing.
const CONFIRMS_M: f64 = 1.0;
/// Number of consecutive chords that confirm a report again.
const CONFIRMATIONS: u8 = 2;

/// Largest differences between reports that resemble each other: of the speed, with a part of it, and of the axis.
const ALIKE_MPS: f64 = 1.0;
const ALIKE_SHARE: f64 = 0.2;
const ALIKE_RAD: f64 = 0.5;

/// The reports that the tracker ignores.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ignored {
    pub speed: bool,
    pub heading: bool,
}

impl Ignored {
    /// The observation without the ignored reports.
    pub const fn without(self, mut seen: Observation) -> Observation {
        if self.speed {
            seen.speed_mps = None;
        }
        if self.heading {
            seen.heading_rad = None;
        }
        seen
    }
}

/// The current chord of an agent, and what the earlier ones have shown.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Chord {
    begun: Option<Begun>,
    pub ignored: Ignored,
    /// Number of consecutive chords that confirm an ignored speed, and an ignored heading.
    confirmed: [u8; 2],
    /// Direction of the chord before.
    course_rad: Option<f64>,
}

/// A chord that has begun.
#[derive(Clone, Copy, Debug)]
struct Begun {
    at_ns: i64,
    from_m: [f64; 2],
    last_ns: i64,
    last: Report,
    /// Way and length along the reports; `None` if a report lacks a speed.
    way: Option<([f64; 2], f64)>,
    /// Sum of (cos 2ψ, sin 2ψ); `None` if a report lacks a heading.
    axis: Option<[f64; 2]>,
}

/// Heading and speed of a detection.
#[derive(Clone, Copy, Debug)]
struct Report {
    heading_rad: Option<f64>,
    speed_mps: Option<f64>,
}

impl Report {
    fn velocity_mps(self) -> Option<[f64; 2]> {
        let (sin, cos) = self.heading_rad?.sin_cos();
        self.speed_mps.map(|speed_mps| [speed_mps * cos, speed_mps * sin])
    }

    /// Whether a later detection has nearly the same speed, and the same heading up to half a turn.
    fn resembles(self, later: &Detection) -> bool {
        let Some((heading_rad, speed_mps)) = self.heading_rad.zip(self.speed_mps) else { return false };
        let off_mps = (speed_mps - f64::from(later.speed_mps)).abs();
        let turn_rad = 0.5 * wrapped(2.0 * (heading_rad - f64::from(later.heading_rad)));
        later.has(detection_flags::HAS_HEADING | detection_flags::HAS_SPEED)
            && off_mps <= ALIKE_MPS + ALIKE_SHARE * speed_mps.abs()
            && turn_rad.abs() <= ALIKE_RAD
    }

    fn axis(self) -> Option<[f64; 2]> {
        self.heading_rad.map(|heading_rad| {
            let (sin, cos) = (2.0 * heading_rad).sin_cos();
            [cos, sin]
        })
    }
}

/// The motion along a chord that contradicts its reports.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved {
    way_m: [f64; 2],
    elapsed_s: f64,
    /// Standard deviation of the way per axis.
    sigma_m: f64,
}

impl Chord {
    /// The chord that begins with this measurement.
    pub fn new(own_ns: i64, seen: &Observation) -> Self {
        let mut chord = Self::default();
        chord.add(own_ns, seen);
        chord
    }

    /// Adds a measurement with this time. If reports are ignored from now on, returns the motion and these reports.
    fn add(&mut self, own_ns: i64, seen: &Observation) -> Option<(Moved, Ignored)> {
        let value = |measured: Option<(f64, f64)>| measured.map(|(value, _)| value);
        let report = Report { heading_rad: value(seen.heading_rad), speed_mps: value(seen.speed_mps) };
        let first = Begun {
            at_ns: own_ns,
            from_m: seen.position_m,
            last_ns: own_ns,
            last: report,
            way: report.velocity_mps().map(|_| ([0.0; 2], 0.0)),
            axis: report.axis(),
        };
        if first.way.is_none() && first.axis.is_none() {
            self.begun = None;
            return None;
        }
        let since_ns = self.begun.map(|begun| own_ns.saturating_sub(begun.last_ns));
        let Some(begun) = self.begun.as_mut().filter(|_| since_ns.is_some_and(|ns| ns <= GAP_MAX_NS)) else {
            self.begun = Some(first);
            return None;
        };
        if own_ns <= begun.last_ns {
            return None;
        }
        begun.continue_to(own_ns, report);
        let elapsed_ns = own_ns.saturating_sub(begun.at_ns);
        let moved = Moved {
            way_m: [0, 1].map(|axis| seen.position_m[axis] - begun.from_m[axis]),
            elapsed_s: elapsed_ns as f64 / 1e9,
            sigma_m: SQRT_2 * seen.position_variance.sqrt(),
        };
        if elapsed_ns < CHORD_NS || (elapsed_ns < CHORD_MAX_NS && !moved.can_contradict(begun.way)) {
            return None;
        }
        let begun = *begun;
        self.begun = Some(first);
        let new = self.judge(&begun, &moved);
        (new != Ignored::default()).then_some((moved, new))
    }

    /// Compares the reports with the motion along a chord. Returns those that are ignored from now on.
    fn judge(&mut self, begun: &Begun, moved: &Moved) -> Ignored {
        let (length_m, [x, y]) = (moved.length_m(), moved.way_m);
        let course_rad = y.atan2(x);
        let before_rad = self.course_rad.replace(course_rad);
        let is_long = length_m > CONFIRMS_M + 2.0 * SIGMAS * moved.sigma_m;
        let straight_rad = STRAIGHT_RAD + moved.sigma_m / length_m;
        let is_straight = length_m > STRAIGHT_MPS * moved.elapsed_s
            && before_rad.is_some_and(|before| wrapped(course_rad - before).abs() <= straight_rad);
        let off_rad = begun.axis.map(|[cos, sin]| 0.5 * wrapped(sin.atan2(cos) - 2.0 * course_rad).abs());
        let heading = off_rad.filter(|_| is_long && is_straight).map(|off_rad| off_rad <= AXIS_RAD);
        let speed = begun.way.and_then(|(way_m, reported_m)| {
            let is_against = x * way_m[0] + y * way_m[1] < 0.0;
            // Without the axis of the heading, the direction shows nothing.
            let along_m = if is_against && heading != Some(false) { -reported_m } else { reported_m };
            match (length_m - along_m).abs() <= moved.tolerance_m(reported_m) {
                false => Some(false),
                true => is_long.then_some(true),
            }
        });
        let Self { ignored, confirmed: [of_speed, of_heading], .. } = self;
        Ignored {
            speed: decide(&mut ignored.speed, of_speed, speed),
            heading: decide(&mut ignored.heading, of_heading, heading),
        }
    }

    /// Whether all reports along the chord have a velocity.
    const fn has_velocities(&self) -> bool {
        matches!(self.begun, Some(Begun { way: Some(_), .. }))
    }

    /// Ignores the reports until chords confirm them.
    pub fn ignore(&mut self) {
        self.ignored = Ignored { speed: true, heading: true };
        self.confirmed = [0; 2];
    }
}

impl Begun {
    fn continue_to(&mut self, own_ns: i64, report: Report) {
        let half_s = 0.5 * own_ns.saturating_sub(self.last_ns) as f64 / 1e9;
        self.way = self.way.zip(self.last.velocity_mps()).zip(report.velocity_mps()).map(
            |((([x, y], length_m), [vx, vy]), [to_vx, to_vy])| {
                let length_m = length_m + half_s * (hypot(vx, vy) + hypot(to_vx, to_vy));
                ([x + half_s * (vx + to_vx), y + half_s * (vy + to_vy)], length_m)
            },
        );
        self.axis = self.axis.zip(report.axis()).map(|([cos, sin], [c, s])| [cos + c, sin + s]);
        (self.last_ns, self.last) = (own_ns, report);
    }
}

impl Moved {
    fn length_m(&self) -> f64 {
        hypot(self.way_m[0], self.way_m[1])
    }

    /// Largest difference to another way of this length that contradicts nothing.
    fn tolerance_m(&self, other_m: f64) -> f64 {
        WAY_M + SIGMAS * self.sigma_m + WAY_SHARE * self.length_m().max(other_m)
    }

    /// Whether noise does not explain the longer one of both ways.
    fn can_contradict(&self, reported: Option<([f64; 2], f64)>) -> bool {
        let longer_m = self.length_m().max(reported.map_or(0.0, |(_, length_m)| length_m));
        longer_m > self.tolerance_m(longer_m)
    }

    fn velocity_mps(&self) -> [f64; 2] {
        self.way_m.map(|way_m| way_m / self.elapsed_s)
    }

    /// Whether an estimate with this velocity already follows the positions.
    fn fits(&self, [vx, vy]: [f64; 2]) -> bool {
        let [x, y] = self.way_m;
        let off_m = hypot(x - vx * self.elapsed_s, y - vy * self.elapsed_s);
        off_m <= self.tolerance_m(hypot(vx, vy) * self.elapsed_s)
    }
}

/// Adds a chord to the evidence about a report. Returns whether the report is ignored from now on.
fn decide(is_ignored: &mut bool, confirmed: &mut u8, confirms: Option<bool>) -> bool {
    match confirms {
        Some(false) => {
            *confirmed = 0;
            !std::mem::replace(is_ignored, true)
        }
        Some(true) if *is_ignored => {
            *confirmed += 1;
            *is_ignored = *confirmed < CONFIRMATIONS;
            false
        }
        _ => false,
    }
}

impl Estimate {
    /// Whether the track is tentative and follows reported velocities.
    #[must_use]
    pub const fn follows_reports(&self) -> bool {
        self.chord.has_velocities() && !self.management.is_confirmed() && !self.chord.ignored.speed
    }

    /// Whether a detection may be the next one of a tentative track although the reported velocity does not lead
    /// there: it has the reports of the last detection, and an agent of this type can have moved from one to the
    /// other.
    #[must_use]
    pub fn resembles(&self, found: &Found<'_>, options: &TrackerOptions) -> bool {
        found.agent_type == self.class.current()
            && self.reaches(found, options)
            && self.chord.begun.is_some_and(|begun| begun.last.resembles(found.detection))
    }

    /// Begins the motion anew at the position of the last detection, because the next one contradicts the reported
    /// velocity.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then that of the last detection.
    pub fn ignore_reports(&mut self, input: &InputModel) -> Result<(), FilterFault> {
        self.chord.ignore();
        let of_type = self.class.current().index();
        let variance = input.sensor[of_type].position_m.powi(2);
        let seen = Observation::of_position(self.reports.last.position_m(), variance);
        self.belief = Belief::new(Filter::start(kind(self.class.current()), &seen, &UNKNOWN[of_type]));
        self.steady = Steady::new(self.belief.filter());
        self.has_velocity = false;
        self.stamp_ns = self.gate.measured_ns;
        self.predict(self.frame_ns, input)
    }

    /// Compares a measurement with the chord of the agent's positions. Returns whether the motion was begun anew,
    /// because it had followed reports that the positions contradict.
    pub(super) fn confirm(&mut self, own_ns: i64, seen: &Observation, input: &InputModel) -> bool {
        let mut seen = *seen;
        if let (Filter::Bicycle(_), Some((heading_rad, _))) = (self.belief.filter(), &mut seen.heading_rad) {
            *heading_rad = folded(*heading_rad, self.published.heading_rad);
        }
        let Some((moved, new)) = self.chord.add(own_ns, &seen) else { return false };
        if !new.heading && moved.fits(self.belief.motion().velocity_mps) {
            return false;
        }
        self.begin_motion(own_ns, &seen, &moved, input);
        true
    }

    /// Begins the motion with the velocity of a chord.
    fn begin_motion(&mut self, own_ns: i64, seen: &Observation, moved: &Moved, input: &InputModel) {
        let agent_type = self.class.current();
        let [vx, vy] = moved.velocity_mps();
        let sigma_mps = moved.sigma_m / moved.elapsed_s + CHANGE_MPS;
        let heading_rad = seen.heading_rad.filter(|_| !self.chord.ignored.heading);
        let course = (vy.atan2(vx), (sigma_mps / hypot(vx, vy).max(sigma_mps)).min(FRAC_PI_2).powi(2));
        let (mut axis_rad, variance) = heading_rad.unwrap_or(course);
        let (sin, cos) = axis_rad.sin_cos();
        let mut speed_mps = vx * cos + vy * sin;
        if is_reversed(speed_mps) {
            (axis_rad, speed_mps) = (wrapped(axis_rad + PI), -speed_mps);
        }
        let begun = Observation {
            heading_rad: Some((axis_rad, variance)),
            speed_mps: Some((speed_mps, sigma_mps.powi(2))),
            ..*seen
        };
        let filter = Filter::start(kind(agent_type), &begun, &UNKNOWN[agent_type.index()]);
        self.belief = Belief::new(filter);
        self.belief.shift(-self.lag_s(own_ns), &self.models(input));
        self.steady = Steady::new(self.belief.filter());
        (self.front, self.front_ns) = (Front::new(), self.stamp_ns);
        self.has_velocity = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_NS: i64 = 100_000_000;

    /// What is ignored after each of `count` measurements, at 10 Hz, of an agent whose place and true heading and
    /// speed are given at each time. `report` changes heading and speed.
    fn ignored(
        count: i64,
        motion: impl Fn(f64) -> ([f64; 2], f64, f64),
        report: impl Fn(f64, f64, f64) -> (f64, f64),
    ) -> Vec<Ignored> {
        let mut chord = Chord::default();
        let add = |tick: i64| {
            let time_s = (tick * TICK_NS) as f64 / 1e9;
            let (position_m, heading_rad, speed_mps) = motion(time_s);
            let (heading_rad, speed_mps) = report(time_s, heading_rad, speed_mps);
            let seen = Observation {
                heading_rad: Some((heading_rad, 0.01)),
                speed_mps: Some((speed_mps, 0.01)),
                ..Observation::of_position(position_m, 0.0025)
            };
            chord.add(tick * TICK_NS, &seen);
            chord.ignored
        };
        (0..count).map(add).collect()
    }

    fn straight(time_s: f64) -> ([f64; 2], f64, f64) {
        ([9.0 * time_s, 0.0], 0.0, 9.0)
    }

    #[test]
    fn right_reports_are_never_ignored() {
        let turn = |time_s: f64| {
            let (sin, cos) = (0.6 * time_s).sin_cos();
            // The heading leads the course of the box's centre.
            ([6.0 * sin, -6.0 * cos], 0.6 * time_s + 0.5, 3.6)
        };
        let braking = |time_s: f64| {
            let braked_s = time_s.min(3.0);
            ([12.0 * braked_s - 2.0 * braked_s * braked_s, 0.0], 0.0, 12.0 - 4.0 * braked_s)
        };
        for ignored in [
            ignored(200, straight, |_, heading, speed| (heading, speed)),
            ignored(200, turn, |_, heading, speed| (heading, speed)),
            ignored(200, braking, |_, heading, speed| (heading, speed)),
        ] {
            assert!(ignored.iter().all(|ignored| *ignored == Ignored::default()));
        }
    }

    #[test]
    fn reports_are_used_again_when_two_chords_confirm_them() {
        let speed = |time_s: f64, heading: f64, speed: f64| (heading, if time_s < 4.0 { 0.0 } else { speed });
        let found = ignored(80, straight, speed);
        assert!(!found[5].speed && found[6..41].iter().all(|ignored| ignored.speed), "{found:?}");
        assert!(!found[56].speed, "two chords of 0.6 s after the one in which the speeds change");
        assert!(found.iter().all(|ignored| !ignored.heading));
        let heading =
            |time_s: f64, heading: f64, speed: f64| (heading + if time_s < 4.0 { 1.0 } else { 0.0 }, speed);
        let found = ignored(80, straight, heading);
        assert!(!found[11].heading && found[12..41].iter().all(|ignored| ignored.heading), "{found:?}");
        assert!(!found[56].heading && found.iter().all(|ignored| !ignored.speed), "{found:?}");
    }
}
