//! Occlusion: how much of an agent the sensor can see past the others.
//!
//! Seen from the sensor, every *outline* (a rectangle on the ground) covers an interval of bearings. The
//! circle of bearings is divided into sectors. Each sector keeps its *reach*: the distance to the far side of
//! the nearest outline that its ray meets. Everything beyond the reach is occluded. The sensor's field of
//! view is a sector of the ground about its heading. Outside it the reach is 0, so an agent there counts as
//! occluded.
//!
//! The *visibility* of an agent is the share of its possible bearings at which it is within the reach. It
//! falls and rises steadily as the agent passes behind another, and rises with the uncertainty of its
//! position.
//!
//! Agents that overlap on the ground do not occlude each other. Of two tracks of one agent, neither therefore
//! excuses the misses of the other. The cost is linear in the number of agents and the sectors that they
//! cover.

use std::f64::consts::{PI, TAU};

use filters::wrapped;
use kinematics::hypot;

use crate::FieldOfView;

/// Number of sectors of the full circle. Each is a third of a degree wide, 0.3 m at 50 m.
const SECTORS: usize = 1024;
const SECTOR_RAD: f64 = TAU / SECTORS as f64;

/// An agent's extent on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// The centre.
    pub centre_m: [f64; 2],
    /// Covariance of the centre as (xx, xy, yy).
    pub covariance_m2: [f64; 3],
    /// The heading.
    pub heading_rad: f64,
    /// Half the length and half the width.
    pub half_m: [f64; 2],
}

/// The distance that the sensor can see at each bearing. Holds only scratch memory.
#[derive(Clone, Debug)]
pub struct Occlusion {
    sensor_m: [f64; 2],
    /// Direction of the middle of each sector as (cos, sin).
    rays: Vec<[f64; 2]>,
    /// Distance beyond which everything is occluded, by sector.
    reach_m: Vec<f64>,
}

impl Occlusion {
    /// A sensor with an unlimited view.
    #[must_use]
    pub fn new() -> Self {
        let ray = |sector: usize| {
            let (sin, cos) = ((sector as f64 + 0.5) * SECTOR_RAD).sin_cos();
            [cos, sin]
        };
        Self {
            sensor_m: [0.0; 2],
            rays: (0..SECTORS).map(ray).collect(),
            reach_m: vec![f64::INFINITY; SECTORS],
        }
    }

    /// Computes the reach of a sensor at a position among `opaque` outlines. If a view is given, the reach is
    /// limited to it.
    pub fn update(
        &mut self,
        sensor_m: [f64; 2],
        view: Option<(f64, FieldOfView)>,
        opaque: impl Iterator<Item = Outline>,
    ) {
        self.sensor_m = sensor_m;
        self.reach_m.fill(f64::INFINITY);
        if let Some((heading_rad, FieldOfView { width_deg, range_m })) = view {
            let half_rad = width_deg.to_radians() / 2.0;
            for (sector, reach_m) in self.reach_m.iter_mut().enumerate() {
                let bearing_rad = (sector as f64 + 0.5) * SECTOR_RAD;
                let is_inside = wrapped(bearing_rad - heading_rad).abs() <= half_rad;
                *reach_m = if is_inside { range_m } else { 0.0 };
            }
        }
        for outline in opaque {
            let [dx, dy] = self.offset_m(&outline);
            let (distance_m, radius_m) = (hypot(dx, dy), hypot(outline.half_m[0], outline.half_m[1]));
            // For a sensor within this radius, the outline may be on all sides.
            let half_rad = if radius_m < distance_m { (radius_m / distance_m).asin() } else { PI };
            let relative = Relative::new([dx, dy], &outline);
            for (sector, _) in sectors(dy.atan2(dx), half_rad) {
                if let Some(exit_m) = relative.exit_m(self.rays[sector]) {
                    self.reach_m[sector] = self.reach_m[sector].min(exit_m);
                }
            }
        }
    }

    /// Share of an outline that is visible, within \[0, 1\].
    #[must_use]
    pub fn visibility(&self, outline: &Outline) -> f64 {
        let [dx, dy] = self.offset_m(outline);
        let distance_m = hypot(dx, dy);
        if distance_m == 0.0 {
            return 1.0;
        }
        let [across_x, across_y] = [-dy / distance_m, dx / distance_m];
        let (sin, cos) = outline.heading_rad.sin_cos();
        let [half_length_m, half_width_m] = outline.half_m;
        let extent_m = (half_length_m * (cos * across_x + sin * across_y)).abs()
            + (half_width_m * (cos * across_y - sin * across_x)).abs();
        let [xx, xy, yy] = outline.covariance_m2;
        let variance_m2 =
            xx * across_x * across_x + 2.0 * xy * across_x * across_y + yy * across_y * across_y;
        let half_rad = ((extent_m + variance_m2.max(0.0).sqrt()) / distance_m).atan();
        let (mut visible, mut all) = (0.0, 0.0);
        for (sector, share) in sectors(dy.atan2(dx), half_rad) {
            all += share;
            visible += if self.reach_m[sector] < distance_m { 0.0 } else { share };
        }
        if all > 0.0 { visible / all } else { 1.0 }
    }

    fn offset_m(&self, outline: &Outline) -> [f64; 2] {
        [0, 1].map(|axis| outline.centre_m[axis] - self.sensor_m[axis])
    }
}

/// The sensor relative to an outline, in its frame.
#[derive(Clone, Copy, Debug)]
struct Relative {
    sensor_m: [f64; 2],
    /// (cos, sin) of the outline's heading.
    axis: [f64; 2],
    half_m: [f64; 2],
}

impl Relative {
    fn new([dx, dy]: [f64; 2], outline: &Outline) -> Self {
        let (sin, cos) = outline.heading_rad.sin_cos();
        Self {
            sensor_m: [-(cos * dx + sin * dy), sin * dx - cos * dy],
            axis: [cos, sin],
            half_m: outline.half_m,
        }
    }

    /// Distance at which a ray leaves the outline; `None` if it misses the outline or starts inside.
    fn exit_m(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let [cos, sin] = self.axis;
        let along = [cos * x + sin * y, cos * y - sin * x];
        let (mut enter_m, mut exit_m) = (0.0_f64, f64::INFINITY);
        for ((along, sensor_m), half_m) in along.into_iter().zip(self.sensor_m).zip(self.half_m) {
            let sides_m = [-half_m, half_m].map(|side_m| (side_m - sensor_m) / along);
            enter_m = enter_m.max(sides_m[0].min(sides_m[1]));
            exit_m = exit_m.min(sides_m[0].max(sides_m[1]));
        }
        (0.0 < enter_m && enter_m <= exit_m).then_some(exit_m)
    }
}

/// The sectors within `half_rad` (at most π) of a bearing, each with the covered share.
fn sectors(bearing_rad: f64, half_rad: f64) -> impl Iterator<Item = (usize, f64)> {
    let [from, to] = [-half_rad, half_rad].map(|off_rad| (bearing_rad + off_rad) / SECTOR_RAD);
    let (first, last) = (from.floor() as i64, to.ceil() as i64);
    (first..last.min(first + SECTORS as i64)).map(move |sector| {
        let share = to.min(sector as f64 + 1.0) - from.max(sector as f64);
        (sector.rem_euclid(SECTORS as i64) as usize, share)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LORRY: Outline = Outline {
        centre_m: [20.0, 0.0],
        covariance_m2: [0.01, 0.0, 0.01],
        heading_rad: PI / 2.0,
        half_m: [4.0, 1.25],
    };

    fn pedestrian(x_m: f64, y_m: f64, sigma_m: f64) -> Outline {
        let variance_m2 = sigma_m * sigma_m;
        Outline {
            centre_m: [x_m, y_m],
            covariance_m2: [variance_m2, 0.0, variance_m2],
            heading_rad: 0.3,
            half_m: [0.25; 2],
        }
    }

    fn visibility(sensor_m: [f64; 2], opaque: &[Outline], of: Outline) -> f64 {
        let mut occlusion = Occlusion::new();
        occlusion.update(sensor_m, None, opaque.iter().copied());
        occlusion.visibility(&of)
    }

    /// A lorry stands ahead on the left. The view reaches 45 degrees to either side of the heading, and 50 m
    /// far.
    #[test]
    fn outlines_out_of_view_are_occluded() {
        let view = FieldOfView { width_deg: 90.0, range_m: 50.0 };
        let mut occlusion = Occlusion::new();
        for heading_rad in [0.0, 3.0, -3.0] {
            let (sin, cos) = f64::sin_cos(heading_rad);
            let turned = |x: f64, y: f64| [cos * x - sin * y, sin * x + cos * y];
            let lorry = Outline {
                centre_m: turned(20.0, 10.0),
                heading_rad: LORRY.heading_rad + heading_rad,
                ..LORRY
            };
            occlusion.update([0.0; 2], Some((heading_rad, view)), std::iter::once(lorry));
            for (x, y, expected) in [
                (30.0, -5.0, 1.0),
                (30.0, 15.0, 0.0),
                (60.0, -5.0, 0.0),
                (5.0, 10.0, 0.0),
                (-30.0, 0.0, 0.0),
                (10.0, 8.0, 1.0),
            ] {
                let [x_m, y_m] = turned(x, y);
                let visibility = occlusion.visibility(&pedestrian(x_m, y_m, 0.1));
                assert!((visibility - expected).abs() < 0.02, "{x}, {y} at {heading_rad}: {visibility}");
            }
            let [x_m, y_m] = turned(20.0, -20.0);
            let visibility = occlusion.visibility(&pedestrian(x_m, y_m, 0.1));
            assert!((0.3..0.7).contains(&visibility), "at the edge: {visibility}");
        }
    }

    #[test]
    fn only_what_is_behind_an_outline_is_occluded() {
        for (x, y, expected) in
            [(25.0, 0.0, 0.0), (25.0, 4.0, 0.0), (15.0, 0.0, 1.0), (25.0, 8.0, 1.0), (18.0, 3.0, 1.0)]
        {
            assert_eq!(visibility([0.0; 2], &[LORRY], pedestrian(x, y, 0.1)), expected, "{x}, {y}");
        }
        // Seen from the other side, front and back are exchanged.
        assert_eq!(visibility([40.0, 0.0], &[LORRY], pedestrian(25.0, 0.0, 0.1)), 1.0);
        assert_eq!(visibility([40.0, 0.0], &[LORRY], pedestrian(15.0, 0.0, 0.1)), 0.0);
        // In front of the long side of a nearby bus, although farther away than the middle of the bus.
        let bus = Outline { centre_m: [5.0, 0.0], half_m: [9.0, 1.25], ..LORRY };
        assert_eq!(visibility([0.0; 2], &[bus], pedestrian(3.0, 7.0, 0.1)), 1.0);
        assert_eq!(visibility([0.0; 2], &[bus], pedestrian(7.0, 7.0, 0.1)), 0.0);
    }

    #[test]
    fn visibility_is_steady_at_an_edge_and_rises_with_uncertainty() {
        let visibilities: Vec<f64> = (0..40)
            .map(|k| visibility([0.0; 2], &[LORRY], pedestrian(25.0, 7.0 - 0.08 * f64::from(k), 0.1)))
            .collect();
        assert!(visibilities[0] == 1.0 && visibilities[39] == 0.0, "{visibilities:?}");
        assert!(
            visibilities.windows(2).all(|pair| (0.0..0.35).contains(&(pair[0] - pair[1]))),
            "{visibilities:?}"
        );
        assert!(visibilities.iter().any(|visibility| (0.2..0.8).contains(visibility)), "{visibilities:?}");
        let by_sigma = [0.5, 4.0, 8.0, 16.0]
            .map(|sigma_m| visibility([0.0; 2], &[LORRY], pedestrian(25.0, 0.0, sigma_m)));
        assert!(by_sigma[0] == 0.0 && by_sigma.windows(2).all(|pair| pair[0] <= pair[1]), "{by_sigma:?}");
        assert!(by_sigma[3] > 0.5, "{by_sigma:?}");
    }

    #[test]
    fn overlapping_outlines_occlude_nothing_of_each_other() {
        let twice = Outline { centre_m: [20.6, 0.4], ..LORRY };
        for (opaque, of) in [(LORRY, twice), (twice, LORRY), (LORRY, LORRY)] {
            let visibility = visibility([0.0; 2], &[opaque], of);
            // A ray or two may cut a corner.
            assert!(visibility > 0.95, "{visibility}");
        }
    }

    /// Behind the sensor bearings jump from π to −π.
    #[test]
    fn visibility_is_the_same_all_round() {
        for k in 0..720 {
            let (sin, cos) = (f64::from(k) * PI / 360.0).sin_cos();
            let lorry = Outline {
                centre_m: [20.0 * cos, 20.0 * sin],
                heading_rad: sin.atan2(cos) + PI / 2.0,
                ..LORRY
            };
            assert_eq!(visibility([0.0; 2], &[lorry], pedestrian(25.0 * cos, 25.0 * sin, 0.2)), 0.0, "{k}");
            assert_eq!(visibility([0.0; 2], &[lorry], pedestrian(-25.0 * cos, -25.0 * sin, 0.2)), 1.0, "{k}");
        }
    }

    /// The sensor on an agent, inside one, or as far away as possible. Agents without extent and with a
    /// covariance of zero.
    #[test]
    fn visibility_of_degenerate_outlines_is_within_0_and_1() {
        let point = Outline { half_m: [0.0; 2], covariance_m2: [0.0; 3], ..LORRY };
        let wide = Outline { half_m: [1e3; 2], covariance_m2: [1e12, 0.0, 1e12], ..LORRY };
        for sensor_m in [[20.0, 0.0], [20.0, 1e-300], [21.25, 0.0], [21.25, 4.0], [-32_768.0, 32_768.0]] {
            for opaque in [LORRY, point, wide] {
                for of in [LORRY, point, wide, pedestrian(20.0, 0.0, 0.0)] {
                    let visibility = visibility(sensor_m, &[opaque, opaque], of);
                    assert!(
                        (0.0..=1.0).contains(&visibility),
                        "{sensor_m:?} {opaque:?} {of:?}: {visibility}"
                    );
                }
            }
        }
    }
}
