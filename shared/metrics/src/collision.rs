use crate::{Point, Share};

/// A forecast with the disc that the agent occupies at each position.
#[derive(Clone, Copy, Debug)]
pub struct Disc<'a> {
    /// Forecast positions, one per step.
    pub trajectory: &'a [Point],
    /// Radius of the disc: half the width of the agent. The agent covers the disc at any heading.
    pub radius_m: f32,
}

/// The share of forecasts that collide with another forecast of the same scene.
///
/// All forecasts belong to one joint future: the single best forecasts, or one mode number. Two forecasts
/// collide if their discs overlap at a step or, on straight lines, between two steps. Overlapping discs imply
/// overlapping footprints, so collisions of long agents are under-counted but never over-counted. Cost:
/// square of the number of agents.
#[must_use]
pub fn collisions(forecasts: &[Disc<'_>]) -> Share {
    let mut share = Share::default();
    for (i, a) in forecasts.iter().enumerate() {
        share.add(forecasts.iter().enumerate().any(|(j, b)| i != j && collide(a, b)));
    }
    share
}

fn collide(a: &Disc<'_>, b: &Disc<'_>) -> bool {
    let reach_m = a.radius_m + b.radius_m;
    let apart = |(a, b): (&Point, &Point)| [b[0] - a[0], b[1] - a[1]];
    let mut before = None;
    a.trajectory.iter().zip(b.trajectory).map(apart).any(|now| {
        let nearest_m = distance_to_origin_m(before.unwrap_or(now), now);
        before = Some(now);
        nearest_m < reach_m
    })
}

/// Smallest distance between the origin and the segment from `a` to `b`.
fn distance_to_origin_m(a: Point, b: Point) -> f32 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let squared = along[0] * along[0] + along[1] * along[1];
    let share = if squared > 0.0 { -(a[0] * along[0] + a[1] * along[1]) / squared } else { 0.0 };
    let share = share.clamp(0.0, 1.0);
    (a[0] + share * along[0]).hypot(a[1] + share * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(trajectory: &[Point]) -> Disc<'_> {
        Disc { trajectory, radius_m: 0.5 }
    }

    #[test]
    fn agents_that_swap_positions_between_steps_collide() {
        let (right, left) = ([[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.0], [0.0, 0.0]]);
        let far = [[0.0, 9.0], [2.0, 9.0]];
        assert_eq!(collisions(&[disc(&right), disc(&left), disc(&far)]).value(), Some(2.0 / 3.0));
    }

    #[test]
    fn passing_at_a_distance_is_no_collision() {
        let (right, left) = ([[0.0, 0.0], [2.0, 0.0]], [[2.0, 1.01], [0.0, 1.01]]);
        assert_eq!(collisions(&[disc(&right), disc(&left)]).value(), Some(0.0));
        assert_eq!(collisions(&[]).value(), None);
    }

    #[test]
    fn the_same_position_at_another_time_is_no_collision() {
        let (early, late) = ([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]], [[-6.0, 0.0], [-3.0, 0.0], [0.0, 0.0]]);
        assert_eq!(collisions(&[disc(&early), disc(&late)]).value(), Some(0.0));
    }
}
