//! Compares headings with the direction of motion, in all common conventions.
//!
//! A chord of an agent's path has a direction. The headings at its ends must agree with this direction within
//! [`TOLERANCE_RAD`]. If they do not, every other [`Reading`] of the same number is tried.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use wire::AgentType;

use crate::tally::{Place, Tally};

/// Largest difference between a heading and the direction of motion.
const TOLERANCE_RAD: f64 = 0.52;
/// Largest angle in radians, unless the headings count full turns.
pub(crate) const RADIANS_MAX: f64 = TAU + 0.01;
/// Largest heading of an agent whose headings count full turns.
const COUNTED_MAX: f64 = 2.0 * TAU;
/// Smallest number of chords that contradict radians.
const CHORDS_MIN: u64 = 8;
/// Share of the disagreeing chords that another reading must explain.
const EXPLAINED: f64 = 0.65;
/// Share of all chords that must disagree before another convention is considered. Some chords always
/// disagree, because agents drive backwards and walk sideways.
const DISAGREEING: f64 = 0.15;
/// The same share for headings that are turned or agree with no convention.
const DISAGREEING_MOST: f64 = 0.5;
/// The same share for headings that are half a turn off. A vehicle with right headings may reverse most of the time.
const BACKWARDS_MOST: f64 = 0.9;
/// Highest speed of a vehicle that reverses. Along an axis, it looks as if headings were mirrored.
const REVERSE_MAX_MPS: f64 = 4.0;

/// Whether a motion in this direction contradicts a number that all rows have as their heading.
pub(crate) fn differs(number_rad: f64, direction_rad: f64) -> bool {
    let off = number_rad - direction_rad;
    off.sin().atan2(off.cos()).abs() > TOLERANCE_RAD
}

/// A convention of headings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Convention {
    /// Counter-clockwise from +x.
    Plain,
    /// Clockwise from +y.
    FromNorth,
    /// Clockwise from +x.
    Mirrored,
    /// Half a turn off.
    Backwards,
    /// A quarter turn too small.
    Quarter,
    /// A quarter turn too large.
    QuarterBack,
    /// Clockwise from -x.
    FromWest,
}

impl Convention {
    const ALL: [Self; 7] = [
        Self::Plain,
        Self::FromNorth,
        Self::Mirrored,
        Self::Backwards,
        Self::Quarter,
        Self::QuarterBack,
        Self::FromWest,
    ];

    /// The direction that a heading denotes.
    fn direction_rad(self, heading_rad: f64) -> f64 {
        match self {
            Self::Plain => heading_rad,
            Self::FromNorth => FRAC_PI_2 - heading_rad,
            Self::Mirrored => -heading_rad,
            Self::Backwards => heading_rad + PI,
            Self::Quarter => heading_rad + FRAC_PI_2,
            Self::QuarterBack => heading_rad - FRAC_PI_2,
            Self::FromWest => PI - heading_rad,
        }
    }

    /// The convention in words, to follow a unit.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::FromNorth => " clockwise from north (+y)",
            Self::Mirrored => " clockwise from +x",
            Self::Backwards => " half a turn off",
            Self::Quarter => " a quarter turn too small",
            Self::QuarterBack => " a quarter turn too large",
            Self::FromWest => " clockwise from -x, or x is flipped",
        }
    }

    /// How to convert the convention to radians counter-clockwise from +x.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::FromNorth => "write π/2 − heading",
            Self::Mirrored => "negate them",
            Self::Backwards => "add π",
            Self::Quarter => "add π/2",
            Self::QuarterBack => "subtract π/2",
            Self::FromWest => "write π − heading, or negate x",
        }
    }
}

/// A unit and a convention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Reading {
    pub degrees: bool,
    pub convention: Convention,
}

/// The comparison of headings with chords.
#[derive(Clone, Debug, Default)]
pub(crate) struct Headings {
    /// Rows with a heading.
    pub rows: u64,
    /// Rows whose heading is not an angle in radians, unless the headings count full turns.
    beyond: Tally,
    /// Rows whose heading is too large even if the headings count full turns.
    far_beyond: Tally,
    /// Rows of compared chords.
    pub compared: u64,
    compared_chords: u64,
    /// Rows of disagreeing chords.
    off: Tally,
    off_chords: u64,
    /// Rows of disagreeing chords of slow vehicles that move backwards.
    reversing: u64,
    /// Rows of disagreeing chords with a heading above [`RADIANS_MAX`].
    off_beyond: u64,
    /// Rows of disagreeing chords by the reading that explains them, in radians and in degrees.
    explained: [[Tally; Convention::ALL.len()]; 2],
}

/// A chord of an agent's path, with the headings at its ends.
#[derive(Debug)]
pub(crate) struct Directed {
    pub direction_rad: f64,
    pub speed_mps: f64,
    pub headings: [f64; 2],
    pub rows: u64,
    pub place: Place,
}

impl Headings {
    /// Counts a row with a heading.
    pub fn row(&mut self, heading: f64, place: Place) {
        self.rows += 1;
        if heading.abs() > RADIANS_MAX {
            self.beyond.add(1, place);
        }
        if heading.abs() > COUNTED_MAX {
            self.far_beyond.add(1, place);
        }
    }

    /// Compares a chord with the headings at its ends.
    pub fn chord(&mut self, chord: &Directed, agent_type: AgentType) {
        let Directed { direction_rad, speed_mps, headings, rows, place } = *chord;
        let off_rad = |unit: f64, convention: Convention| {
            let [sin, cos] = headings.iter().fold([0.0, 0.0], |[sin, cos], &heading| {
                let (s, c) = convention.direction_rad(heading * unit).sin_cos();
                [sin + s, cos + c]
            });
            let off = sin.atan2(cos) - direction_rad;
            off.sin().atan2(off.cos()).abs()
        };
        // Opposite headings have no mean. No convention explains them.
        let turn_rad = headings[1] - headings[0];
        let agrees = |unit: f64, convention: Convention| {
            (turn_rad * unit).cos() > 0.0 && off_rad(unit, convention) <= TOLERANCE_RAD
        };
        let is_beyond = headings.iter().any(|heading| heading.abs() > RADIANS_MAX);
        // A large number sometimes agrees by chance: 90 rad wraps to 2.04 rad, less than 30° from 90°.
        let is_nearer_in_degrees =
            is_beyond && off_rad(PI / 180.0, Convention::Plain) < off_rad(1.0, Convention::Plain);
        self.compared += rows;
        self.compared_chords += 1;
        if agrees(1.0, Convention::Plain) && !is_nearer_in_degrees {
            return;
        }
        self.off.add(rows, place);
        self.off_chords += 1;
        self.off_beyond += if is_beyond { rows } else { 0 };
        let may_reverse = agent_type == AgentType::Vehicle && speed_mps <= REVERSE_MAX_MPS;
        self.reversing += if may_reverse && agrees(1.0, Convention::Backwards) { rows } else { 0 };
        for (unit, tallies) in [1.0, PI / 180.0].into_iter().zip(&mut self.explained) {
            if unit == 1.0 || is_beyond {
                for (convention, tally) in Convention::ALL.into_iter().zip(tallies) {
                    if agrees(unit, convention) {
                        tally.add(rows, place);
                    }
                }
            }
        }
    }

    /// Share of the compared rows that agree; `None` if no row was compared.
    pub fn agreeing(&self) -> Option<f64> {
        (self.compared > 0).then(|| 1.0 - self.off.rows as f64 / self.compared as f64)
    }

    /// The probable meaning of the headings, with the rows that support it and the number of examined rows.
    /// The result is `None` if the headings are radians counter-clockwise from +x. A reading of `None` agrees
    /// with no convention.
    pub fn doubt(&self) -> Option<(Option<Reading>, Tally, u64)> {
        let best = |degrees: bool| {
            let tallies = self.explained[usize::from(degrees)];
            let mut best = (Convention::Plain, Tally::default());
            for (convention, tally) in Convention::ALL.into_iter().zip(tallies) {
                if tally.rows > best.1.rows {
                    best = (convention, tally);
                }
            }
            (Some(Reading { degrees, convention: best.0 }), best.1)
        };
        let share = |rows: u64, of: u64| rows as f64 / of.max(1) as f64;
        let of = self.compared;
        if self.off_chords < CHORDS_MIN {
            // Nothing moves, so only the numbers themselves can show the unit.
            let is_far = self.far_beyond.rows >= CHORDS_MIN && self.compared_chords < CHORDS_MIN;
            let reading = Reading { degrees: true, convention: Convention::Plain };
            return is_far.then_some((Some(reading), self.beyond, self.rows));
        }
        let (degrees, tally) = best(true);
        if self.off_beyond > 0 && share(tally.rows, self.off_beyond) >= EXPLAINED {
            return Some((degrees, self.beyond, self.rows));
        }
        let (radians, tally) = best(false);
        let off = share(self.off.rows, of);
        let reverses = share(self.reversing, self.off.rows) >= EXPLAINED;
        let most = match radians.map(|reading| reading.convention) {
            _ if reverses => BACKWARDS_MOST,
            Some(Convention::Backwards) => BACKWARDS_MOST,
            Some(Convention::Quarter | Convention::QuarterBack) => DISAGREEING_MOST,
            _ => DISAGREEING,
        };
        let explains = share(tally.rows, self.off.rows) >= EXPLAINED;
        match () {
            () if explains && off >= most => Some((radians, tally, of)),
            () if explains && most == BACKWARDS_MOST => None,
            () if off >= DISAGREEING_MOST => Some((None, self.off, of)),
            () => None,
        }
    }
}
