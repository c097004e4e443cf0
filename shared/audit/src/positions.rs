//! The positions of a recording as a whole: degrees of longitude and latitude, and boxes on top of each other.

use wire::{Detection, detection_flags};

use crate::agent::Spot;
use crate::tally::{Place, Tally};

/// Smallest number of rows for a doubt.
const ROWS_MIN: u64 = 60;
/// Largest extent of a scene in degrees, and smallest coordinate of a place that is not the origin.
const EXTENT_MAX: f32 = 0.5;
const COORDINATE_MIN: f32 = 1.0;
/// Number of detections in a frame for which such an extent in metres has no room.
const CROWD: u64 = 3;
/// Highest speed in degrees a second: 111 m/s.
const DEGREES_MAX_PER_S: f64 = 1e-3;
/// Share of an agent's ways that is steady at such a speed.
const STEADY_SHARE: f64 = 0.5;
/// Share of the rows that agents have on top of each other where tracks cross.
const STACKED_SHARE: f64 = 0.03;
/// Usual length and width of an agent, by type.
const SIZES_M: [[f32; 2]; 3] = [[4.0, 1.6], [1.6, 0.5], [0.4, 0.4]];

/// The range of all positions.
#[derive(Clone, Debug)]
pub(crate) struct Extent {
    low: [f32; 2],
    high: [f32; 2],
    all: Tally,
    /// Rows of ways that are slower than any agent, and those of them that continue the previous way.
    ways: u64,
    steady: u64,
}

impl Default for Extent {
    fn default() -> Self {
        let [low, high] = [[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]];
        Self { low, high, all: Tally::default(), ways: 0, steady: 0 }
    }
}

impl Extent {
    pub fn row(&mut self, spot: &Spot) {
        for (axis, value) in spot.position_m.into_iter().enumerate() {
            (self.low[axis], self.high[axis]) = (self.low[axis].min(value), self.high[axis].max(value));
        }
        self.all.add(1, spot.place);
    }

    /// Adds a way of an agent at this speed.
    pub const fn way(&mut self, speed_mps: f64, steady: bool, rows: u64) {
        self.ways += rows;
        if steady && speed_mps < DEGREES_MAX_PER_S {
            self.steady += rows;
        }
    }

    /// The rows, if the positions are degrees of longitude and latitude in any order.
    pub fn degrees(&self, frames: u64) -> Option<Tally> {
        let most = [0, 1].map(|axis| self.low[axis].abs().max(self.high[axis].abs()));
        let is_narrow = [0, 1].into_iter().all(|axis| self.high[axis] - self.low[axis] < EXTENT_MAX);
        let are_degrees = most[0].min(most[1]) <= 90.0 && most[0].max(most[1]) <= 180.0;
        let is_crowded = self.all.rows >= CROWD * frames;
        let is_steady = self.steady > 0 && self.steady as f64 >= STEADY_SHARE * self.ways as f64;
        let is_far = most[0].max(most[1]) >= COORDINATE_MIN;
        let is_found =
            self.all.rows >= ROWS_MIN && is_narrow && are_degrees && is_far && (is_crowded || is_steady);
        is_found.then_some(self.all)
    }
}

/// A box of the present frame.
#[derive(Clone, Copy, Debug)]
struct Footprint {
    position_m: [f32; 2],
    id: Option<u64>,
    /// Cosine and sine of the heading.
    along: Option<[f32; 2]>,
    size_m: [f32; 2],
}

/// Detections whose centre is inside another box of the same frame.
#[derive(Clone, Debug)]
pub(crate) struct Stacks {
    frame: u64,
    boxes: Vec<Footprint>,
    stacked: Tally,
}

impl Stacks {
    pub fn new() -> Self {
        Self { frame: 0, boxes: Vec::with_capacity(wire::DETECTIONS_MAX), stacked: Tally::default() }
    }

    /// The detections on top of others, if there are more than agents that pass each other have.
    pub fn doubt(&self, rows: u64) -> Option<Tally> {
        (self.stacked.rows as f64 > STACKED_SHARE * rows as f64).then_some(self.stacked)
    }

    pub fn clear(&mut self) {
        self.stacked = Tally::default();
    }

    /// Adds a detection of a frame. Detections beyond the limit of a frame are not examined.
    pub fn row(&mut self, frame: u64, detection: &Detection, place: Place) {
        if frame != self.frame {
            self.boxes.clear();
            self.frame = frame;
        }
        let given = |flag: u32| detection.has(flag);
        let usual = SIZES_M.get(detection.agent_type as usize).copied().unwrap_or(SIZES_M[0]);
        let size_m = [detection.length_m, detection.width_m];
        let is_sized = given(detection_flags::HAS_SIZE) && size_m.iter().all(|size_m| *size_m > 0.0);
        let new = Footprint {
            position_m: [detection.x_m, detection.y_m],
            id: given(detection_flags::HAS_ID).then_some(detection.id),
            along: given(detection_flags::HAS_HEADING).then(|| {
                let (sin, cos) = detection.heading_rad.sin_cos();
                [cos, sin]
            }),
            size_m: if is_sized { size_m } else { usual },
        };
        if self.boxes.iter().any(|other| other.is_below(&new)) {
            self.stacked.add(1, place);
        }
        if self.boxes.len() < wire::DETECTIONS_MAX {
            self.boxes.push(new);
        }
    }
}

impl Footprint {
    /// Whether two boxes cover most of each other. Two agents cannot.
    fn is_below(&self, other: &Self) -> bool {
        if self.id.is_some() && self.id == other.id {
            return false;
        }
        let [x_m, y_m] = [0, 1].map(|axis| other.position_m[axis] - self.position_m[axis]);
        let [length_m, width_m] = [0, 1].map(|axis| self.size_m[axis].min(other.size_m[axis]) / 2.0);
        match self.along.or(other.along) {
            Some([cos, sin]) => {
                (x_m * cos + y_m * sin).abs() < length_m && (y_m * cos - x_m * sin).abs() < width_m
            }
            None => x_m.hypot(y_m) < width_m.min(length_m),
        }
    }
}
