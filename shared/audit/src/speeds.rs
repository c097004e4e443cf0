//! Speeds of the agents of a type: from their positions, and as reported.

use wire::AgentType;

use crate::histogram::Histogram;
use crate::tally::{Place, Tally};

/// Speed from which an agent counts as moving.
const MOVING_MPS: f64 = 0.3;
/// Mean reported speed from which a chord is compared with it.
const COMPARED_MPS: f64 = 1.0;
/// Smallest number of chords for percentiles.
const CHORDS_MIN: u64 = 20;
/// Smallest number of chords in another unit.
const UNIT_CHORDS_MIN: u64 = 8;
/// Usual ratios between the speeds of the positions and the reported speeds.
const RATIOS: std::ops::RangeInclusive<f64> = 0.87..=1.15;
/// Share of the chords with another ratio that a unit must explain.
const EXPLAINED: f64 = 0.65;
/// Tolerance of a unit's ratio.
const TOLERANCE: f64 = 0.045;

/// Units of a reported speed, each with the number of units per m/s. The last entry means positions in feet.
const UNITS: [(Unit, f64); 4] =
    [(Unit::Kmh, 3.6), (Unit::Mph, 2.236_94), (Unit::FeetPerSecond, 3.280_84), (Unit::InFeet, 0.304_8)];

/// A unit that explains the difference between positions and reported speeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unit {
    /// Speeds in km/h.
    Kmh,
    /// Speeds in mph.
    Mph,
    /// Speeds in feet per second.
    FeetPerSecond,
    /// Positions in feet, speeds in m/s.
    InFeet,
}

/// A part of an agent's path, with the values reported along it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chord {
    pub way_m: f64,
    pub elapsed_s: f64,
    pub reported_m: Option<f64>,
    pub rows: u64,
    pub place: Place,
    /// Whether the motion continues that of the previous chord.
    pub steady: bool,
}

/// Usual speeds of the moving agents of a type: smallest and largest median, largest 95th percentile.
pub(crate) const fn usual_mps(agent_type: AgentType) -> [f64; 3] {
    match agent_type {
        AgentType::Vehicle => [0.0, 45.0, 60.0],
        AgentType::Cyclist => [0.8, 9.0, 16.0],
        AgentType::Pedestrian => [0.5, 2.0, 6.0],
    }
}

/// Whether a motion at this speed contradicts a number that all rows have as their speed.
pub(crate) fn differs(number_mps: f64, speed_mps: f64) -> bool {
    (speed_mps - number_mps.abs()).abs() > (0.25 * number_mps.abs()).max(0.5)
}

/// The chords of a type.
#[derive(Clone, Debug)]
pub(crate) struct Speeds {
    moving_mps: Histogram,
    moving: Tally,
    /// Rows of chords that are faster than usual.
    fast: Tally,
    ratios: Histogram,
    /// Rows of compared chords.
    compared: Tally,
    /// Rows of compared chords with an unusual ratio.
    off: Tally,
    /// Rows of these chords by the unit that explains them, and the number of chords.
    by_unit: [(Tally, u64); UNITS.len()],
    /// Whether some agents have no identity. Agents joined by place may jump, which would cause false alarms.
    loose: bool,
}

/// The fault of a type's reported speeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpeedDoubt {
    pub unit: Option<Unit>,
    /// Median ratio between the speeds of the positions and the reported speeds.
    pub ratio: f64,
    pub tally: Tally,
    pub of: u64,
}

impl Speeds {
    pub fn new() -> Self {
        Self {
            moving_mps: Histogram::new(),
            moving: Tally::default(),
            fast: Tally::default(),
            ratios: Histogram::new(),
            compared: Tally::default(),
            off: Tally::default(),
            by_unit: Default::default(),
            loose: false,
        }
    }

    pub fn clear(&mut self) {
        self.moving_mps.clear();
        self.ratios.clear();
        self.by_unit = Default::default();
        (self.moving, self.fast, self.compared) = Default::default();
        self.off = Default::default();
    }

    pub const fn is_loose(&mut self) {
        self.loose = true;
    }

    pub fn chord(&mut self, agent_type: AgentType, chord: Chord) {
        let Chord { way_m, elapsed_s, reported_m, rows, place, .. } = chord;
        let speed_mps = way_m / elapsed_s;
        if speed_mps >= MOVING_MPS {
            self.moving_mps.add(speed_mps);
            self.moving.add(rows, place);
            let [_, _, most_high_mps] = usual_mps(agent_type);
            self.fast.add(if speed_mps > most_high_mps { rows } else { 0 }, place);
        }
        let Some(reported_m) = reported_m.filter(|way_m| way_m / elapsed_s >= COMPARED_MPS) else { return };
        let ratio = way_m / reported_m;
        self.ratios.add(ratio);
        self.compared.add(rows, place);
        if RATIOS.contains(&ratio) {
            return;
        }
        self.off.add(rows, place);
        for ((_, per_mps), (tally, chords)) in UNITS.into_iter().zip(&mut self.by_unit) {
            if (ratio * per_mps - 1.0).abs() <= TOLERANCE {
                tally.add(rows, place);
                *chords += 1;
            }
        }
    }

    /// Median and 95th percentile of the speeds of moving agents.
    pub fn moving_mps(&self) -> Option<[f64; 2]> {
        Some([self.moving_mps.percentile(50)?, self.moving_mps.percentile(95)?])
    }

    /// Median ratio between the speeds of the positions and the reported speeds.
    pub fn ratio(&self) -> Option<f64> {
        self.ratios.percentile(50)
    }

    /// Whether positions and reported speeds agree; `None` if there are too few reported speeds.
    pub fn agree(&self) -> Option<bool> {
        (self.ratios.len() >= CHORDS_MIN).then(|| self.ratio().is_some_and(|ratio| RATIOS.contains(&ratio)))
    }

    /// The speeds and their rows, if they are unusual for the type.
    pub fn unusual(&self, agent_type: AgentType) -> Option<([f64; 2], Tally)> {
        let speeds_mps @ [median_mps, high_mps] = self.moving_mps()?;
        let [least_mps, most_mps, most_high_mps] = usual_mps(agent_type);
        let wider = if self.loose { 2.0 } else { 1.0 };
        let medians_mps = least_mps / wider..=most_mps * wider;
        let tally = match () {
            () if !medians_mps.contains(&median_mps) => self.moving,
            () if high_mps > most_high_mps * wider => self.fast,
            () => return None,
        };
        (self.moving_mps.len() >= CHORDS_MIN).then_some((speeds_mps, tally))
    }

    /// The fault of the reported speeds.
    pub fn reported(&self) -> Option<SpeedDoubt> {
        let ratio = self.ratio()?;
        let of = self.compared.rows;
        for ((unit, _), (tally, chords)) in UNITS.into_iter().zip(self.by_unit) {
            let explains = tally.rows as f64 >= EXPLAINED * self.off.rows as f64;
            if chords >= UNIT_CHORDS_MIN && explains {
                return Some(SpeedDoubt { unit: Some(unit), ratio, tally, of });
            }
        }
        let is_off = self.agree() == Some(false);
        is_off.then_some(SpeedDoubt { unit: None, ratio, tally: self.off, of })
    }
}
