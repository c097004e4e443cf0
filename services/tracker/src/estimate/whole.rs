//! Boxes around the visible part of a long vehicle.
//!
//! A detector sees 4 m or all 12 m of a bus, so the centre of its box jumps by 4 m, although one end of the box
//! stays where it was. The estimate therefore keeps the length of the *whole* vehicle. The centre of a box of
//! another length is moved along its axis, so that the end that fits the prediction stays.

use kinematics::hypot;
use wire::{AgentType, Detection, detection_flags};

use super::Estimate;
use crate::belief::Belief;
use crate::noise::Measurements;
use crate::steady::Steady;

/// Smallest length of a long vehicle. The boxes of cars vary too, but their centres stay nearer.
pub const LONG_M: f32 = 7.0;
/// Smallest difference of lengths that the noise of a detector does not explain.
const DIFFERENCE_M: f32 = 1.5;
/// Distance from the prediction within which a centre needs no other explanation.
const NEAR_M: f64 = 1.0;
/// Largest distance along an axis from the prediction: half the length of a road train.
const OFF_MAX_M: f64 = 15.0;
/// Number of consecutive longer boxes, or of shorter ones, after which the vehicle has their length.
const LONGER: u8 = 2;
const SHORTER: u8 = 100;

/// The length of the whole vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Whole {
    /// 0 if it is unknown.
    length_m: f32,
    longer: u8,
    shorter: u8,
    /// Way from the centre of the frame's box to the centre of the whole vehicle.
    way_m: [f32; 2],
}

impl Whole {
    pub const fn new(length_m: f32) -> Self {
        Self { length_m, longer: 0, shorter: 0, way_m: [0.0; 2] }
    }

    /// Counts a box of this length. Returns whether it is the new length of the whole vehicle.
    fn count(&mut self, length_m: f32) -> bool {
        let longer_m = length_m - self.length_m;
        (self.longer, self.shorter) = match () {
            () if longer_m.abs() <= DIFFERENCE_M => (0, 0),
            () if longer_m > 0.0 => (self.longer + 1, 0),
            () => (self.longer, self.shorter + 1),
        };
        let is_new = self.longer >= LONGER || self.shorter >= SHORTER || self.length_m == 0.0;
        if is_new {
            *self = Self::new(length_m);
        }
        is_new
    }
}

/// The length of a vehicle's box; 0 if it has none.
pub fn length_m(detection: &Detection) -> f32 {
    let is_sized =
        detection.has(detection_flags::HAS_SIZE) && detection.agent_type == AgentType::Vehicle as u32;
    if is_sized { detection.length_m } else { 0.0 }
}

impl Estimate {
    /// Whether the whole vehicle is a long one.
    #[must_use]
    pub fn is_long(&self) -> bool {
        self.whole.length_m >= LONG_M
    }

    /// Where the centre of the whole vehicle is if the detection shows the vehicle, and the distance from the
    /// prediction. The centre of a box that fits the prediction stays.
    #[must_use]
    pub fn whole_centre(&self, own_ns: i64, detection: &Detection) -> Option<([f32; 2], f64)> {
        let place_m = [detection.x_m, detection.y_m];
        let motion = &self.published.motion;
        let lag_s = self.lag_s(own_ns);
        let off_m: [f64; 2] = std::array::from_fn(|axis| {
            f64::from(place_m[axis]) - motion.position_m[axis] - lag_s * motion.velocity_mps[axis]
        });
        if off_m.iter().any(|off_m| off_m.abs() > OFF_MAX_M) {
            return None;
        }
        let distance_m = hypot(off_m[0], off_m[1]);
        if distance_m <= NEAR_M {
            return Some((place_m, distance_m));
        }
        let [whole_m, length_m] = [self.whole.length_m, length_m(detection)];
        if whole_m.max(length_m) < LONG_M || (whole_m - length_m).abs() <= DIFFERENCE_M {
            return None;
        }
        // Without a heading, the centre has jumped along the axis.
        let axis = if detection.has(detection_flags::HAS_HEADING) {
            let (sin, cos) = f64::from(detection.heading_rad).sin_cos();
            [cos, sin]
        } else {
            off_m.map(|off_m| off_m / distance_m)
        };
        let along_m = off_m[0] * axis[0] + off_m[1] * axis[1];
        let back_m = (0.5 * f64::from(whole_m - length_m)).abs().copysign(along_m);
        let left_m = hypot(off_m[0] - back_m * axis[0], off_m[1] - back_m * axis[1]);
        let centre_m = std::array::from_fn(|i| (f64::from(place_m[i]) - back_m * axis[i]) as f32);
        (2.0 * left_m <= distance_m).then_some((centre_m, left_m))
    }

    /// Sets the way from the centre of the frame's box to the centre of the whole vehicle.
    pub const fn move_box(&mut self, way_m: [f32; 2]) {
        self.whole.way_m = way_m;
    }

    /// Counts the length of the box that has updated the estimate. If the whole vehicle has this length, the motion
    /// continues at the centre of this box.
    pub(super) fn count_length(&mut self, length_m: f32) {
        let way_m = std::mem::take(&mut self.whole.way_m);
        if length_m > 0.0 && self.whole.count(length_m) && way_m != [0.0; 2] {
            let (place_m, [xx, _, yy]) = self.belief.position();
            let centre_m = std::array::from_fn(|axis| place_m[axis] - f64::from(way_m[axis]));
            self.belief = Belief::new(self.belief.filter().moved_to(centre_m, 0.5 * (xx + yy)));
            self.steady = Steady::new(self.belief.filter());
            self.measurements = Measurements::default();
        }
    }
}
