//! Who hides whom: how much of an agent the sensor can see past the others.
//!
//! What the sensor can see at best is a sector of the ground about its heading; who is outside of it is as hidden as who is behind another.
//!
//! Seen from the sensor, every *outline* (a rectangle on the ground) fills an interval of bearings. All round the sensor the
//! bearings are cut into sectors, and for each is kept how far one can see in it: to behind the nearest outline that its
//! ray meets. What lies farther away is hidden there. The *visible share* of an agent is that of the bearings in which it may be,
//! so that it falls and rises steadily as the agent passes behind another, and rises the less its place is known.
//!
//! Agents that overlap on the ground hide nothing of each other: where one was detected twice, neither excuses the other.
//! The cost is linear in the number of agents and the sectors that they fill.

use std::f64::consts::{PI, TAU};

use filters::wrapped;

use crate::FieldOfView;

/// Sectors all round: a third of a degree each, 0.3 m at 50 m.
const SECTORS: usize = 1024;
const SECTOR_RAD: f64 = TAU / SECTORS as f64;

/// Where an agent stands on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Its centre.
    pub centre_m: [f64; 2],
    /// Covariance of the centre as (xx, xy, yy).
    pub covariance_m2: [f64; 3],
    /// Heading.
    pub heading_rad: f64,
    /// Half its length and half its width.
    pub half_m: [f64; 2],
}

/// How far the sensor can see; holds only scratch memory.
#[derive(Clone, Debug)]
pub struct Occlusion {
    sensor_m: [f64; 2],
    /// The middle of each sector as (cos, sin).
    rays: Vec<[f64; 2]>,
    /// Distance behind which nothing can be seen, by sector.
    reach_m: Vec<f64>,
}

impl Occlusion {
    /// An open view.
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

    /// Looks from a place at outlines that nothing can be seen through; within a view along the heading, if there is one.
    pub fn look(
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
            let (distance_m, radius_m) = (dx.hypot(dy), outline.half_m[0].hypot(outline.half_m[1]));
            // Whoever stands within that may have to be looked for all round.
            let half_rad = if radius_m < distance_m { (radius_m / distance_m).asin() } else { PI };
            let turned = Turned::new([dx, dy], &outline);
            for (sector, _) in sectors(dy.atan2(dx), half_rad) {
                if let Some(exit_m) = turned.exit_m(self.rays[sector]) {
                    self.reach_m[sector] = self.reach_m[sector].min(exit_m);
                }
            }
        }
    }

    /// Share of an outline that can be seen, within \[0, 1\].
    #[must_use]
    pub fn visible_share(&self, outline: &Outline) -> f64 {
        let [dx, dy] = self.offset_m(outline);
        let distance_m = dx.hypot(dy);
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
        let (mut seen, mut all) = (0.0, 0.0);
        for (sector, share) in sectors(dy.atan2(dx), half_rad) {
            all += share;
            seen += if self.reach_m[sector] < distance_m { 0.0 } else { share };
        }
        if all > 0.0 { seen / all } else { 1.0 }
    }

    fn offset_m(&self, outline: &Outline) -> [f64; 2] {
        [0, 1].map(|axis| outline.centre_m[axis] - self.sensor_m[axis])
    }
}

/// The sensor in the frame of an outline.
#[derive(Clone, Copy, Debug)]
struct Turned {
    sensor_m: [f64; 2],
    /// (cos, sin) of the outline's heading.
    axis: [f64; 2],
    half_m: [f64; 2],
}

impl Turned {
    fn new([dx, dy]: [f64; 2], outline: &Outline) -> Self {
        let (sin, cos) = outline.heading_rad.sin_cos();
        Self {
            sensor_m: [-(cos * dx + sin * dy), sin * dx - cos * dy],
            axis: [cos, sin],
            half_m: outline.half_m,
        }
    }

    /// Distance at which a ray leaves the outline; none where it misses it or starts inside.
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

/// The sectors about a bearing, each with the share of it that lies within `half_rad`, at most half the circle.
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

    fn walker(x_m: f64, y_m: f64, sigma_m: f64) -> Outline {
        let variance_m2 = sigma_m * sigma_m;
        Outline {
            centre_m: [x_m, y_m],
            covariance_m2: [variance_m2, 0.0, variance_m2],
            heading_rad: 0.3,
            half_m: [0.25; 2],
        }
    }

    fn share(sensor_m: [f64; 2], opaque: &[Outline], of: Outline) -> f64 {
        let mut occlusion = Occlusion::new();
        occlusion.look(sensor_m, None, opaque.iter().copied());
        occlusion.visible_share(&of)
    }

    /// Ahead to the left there is a lorry; the view goes 45 degrees to either side of the heading, and 50 m far.
    #[test]
    fn who_is_out_of_view_is_hidden() {
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
            occlusion.look([0.0; 2], Some((heading_rad, view)), std::iter::once(lorry));
            for (x, y, expected) in [
                (30.0, -5.0, 1.0),
                (30.0, 15.0, 0.0),
                (60.0, -5.0, 0.0),
                (5.0, 10.0, 0.0),
                (-30.0, 0.0, 0.0),
                (10.0, 8.0, 1.0),
            ] {
                let [x_m, y_m] = turned(x, y);
                let share = occlusion.visible_share(&walker(x_m, y_m, 0.1));
                assert!((share - expected).abs() < 0.02, "{x}, {y} at {heading_rad}: {share}");
            }
            let [x_m, y_m] = turned(20.0, -20.0);
            let share = occlusion.visible_share(&walker(x_m, y_m, 0.1));
            assert!((0.3..0.7).contains(&share), "at the edge: {share}");
        }
    }

    #[test]
    fn who_is_behind_is_hidden_and_who_is_before_or_beside_is_not() {
        for (x, y, expected) in
            [(25.0, 0.0, 0.0), (25.0, 4.0, 0.0), (15.0, 0.0, 1.0), (25.0, 8.0, 1.0), (18.0, 3.0, 1.0)]
        {
            assert_eq!(share([0.0; 2], &[LORRY], walker(x, y, 0.1)), expected, "{x}, {y}");
        }
        // From the other side it is the other way round.
        assert_eq!(share([40.0, 0.0], &[LORRY], walker(25.0, 0.0, 0.1)), 1.0);
        assert_eq!(share([40.0, 0.0], &[LORRY], walker(15.0, 0.0, 0.1)), 0.0);
        // Before the long side of a bus that passes close by, though farther away than its middle.
        let bus = Outline { centre_m: [5.0, 0.0], half_m: [9.0, 1.25], ..LORRY };
        assert_eq!(share([0.0; 2], &[bus], walker(3.0, 7.0, 0.1)), 1.0);
        assert_eq!(share([0.0; 2], &[bus], walker(7.0, 7.0, 0.1)), 0.0);
    }

    #[test]
    fn the_share_falls_steadily_at_an_edge_and_rises_with_doubt() {
        let shares: Vec<f64> = (0..40)
            .map(|k| share([0.0; 2], &[LORRY], walker(25.0, 7.0 - 0.08 * f64::from(k), 0.1)))
            .collect();
        assert!(shares[0] == 1.0 && shares[39] == 0.0, "{shares:?}");
        assert!(shares.windows(2).all(|pair| (0.0..0.35).contains(&(pair[0] - pair[1]))), "{shares:?}");
        assert!(shares.iter().any(|share| (0.2..0.8).contains(share)), "{shares:?}");
        let doubted =
            [0.5, 4.0, 8.0, 16.0].map(|sigma_m| share([0.0; 2], &[LORRY], walker(25.0, 0.0, sigma_m)));
        assert!(doubted[0] == 0.0 && doubted.windows(2).all(|pair| pair[0] <= pair[1]), "{doubted:?}");
        assert!(doubted[3] > 0.5, "{doubted:?}");
    }

    #[test]
    fn who_overlaps_hides_nothing() {
        let twice = Outline { centre_m: [20.6, 0.4], ..LORRY };
        for (opaque, of) in [(LORRY, twice), (twice, LORRY), (LORRY, LORRY)] {
            let share = share([0.0; 2], &[opaque], of);
            // But for a ray or two that cut a corner.
            assert!(share > 0.95, "{share}");
        }
    }

    /// Behind the sensor bearings go from π to −π.
    #[test]
    fn there_is_no_seam() {
        for k in 0..720 {
            let (sin, cos) = (f64::from(k) * PI / 360.0).sin_cos();
            let lorry = Outline {
                centre_m: [20.0 * cos, 20.0 * sin],
                heading_rad: sin.atan2(cos) + PI / 2.0,
                ..LORRY
            };
            assert_eq!(share([0.0; 2], &[lorry], walker(25.0 * cos, 25.0 * sin, 0.2)), 0.0, "{k}");
            assert_eq!(share([0.0; 2], &[lorry], walker(-25.0 * cos, -25.0 * sin, 0.2)), 1.0, "{k}");
        }
    }

    /// The sensor on an agent, in one, or as far away as can be; agents without extent, with a covariance of zero.
    #[test]
    fn odd_places_give_a_share() {
        let point = Outline { half_m: [0.0; 2], covariance_m2: [0.0; 3], ..LORRY };
        let wide = Outline { half_m: [1e3; 2], covariance_m2: [1e12, 0.0, 1e12], ..LORRY };
        for sensor_m in [[20.0, 0.0], [20.0, 1e-300], [21.25, 0.0], [21.25, 4.0], [-32_768.0, 32_768.0]] {
            for opaque in [LORRY, point, wide] {
                for of in [LORRY, point, wide, walker(20.0, 0.0, 0.0)] {
                    let share = share(sensor_m, &[opaque, opaque], of);
                    assert!((0.0..=1.0).contains(&share), "{sensor_m:?} {opaque:?} {of:?}: {share}");
                }
            }
        }
    }
}
