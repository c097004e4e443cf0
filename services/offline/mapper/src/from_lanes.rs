//! A map without recordings: every lane as if agents drove along it, most of them in its middle.

use lanes::{Lane, LaneMap};
use scene::{AgentType, ContextMap, MapBuilder};

use crate::{MapError, Visit};

/// Distance between visits across a lane.
const ACROSS_M: f32 = 0.5;
/// Standard deviation of the visits across a lane, as a share of its half width.
const SPREAD: f32 = 0.5;
/// Visits at a point in the middle of a lane.
const VISITS_MAX: f32 = 8.0;
/// Lateral acceleration of agents in bends.
const LATERAL_MPS2: f32 = 2.0;
/// Minimum speed of a visit.
const SPEED_MIN_MPS: f32 = 2.0;
/// Number of points to either side over which the bend at a point is measured.
const BEND_POINTS: usize = 4;
/// Speed on lanes without a limit.
const SPEED_USUAL_MPS: f32 = 13.9;

/// The map of all lanes that vehicles or cyclists use. Velocities point along the lane, at its limit or
/// slower in bends. Most visits are in the middle of a lane, and there are none in areas that traffic must
/// not enter.
///
/// # Errors
/// [`MapError`] if no lane is for vehicles or cyclists, or if the lanes span more than a map can hold.
pub fn of_lanes(map: &LaneMap) -> Result<ContextMap, MapError> {
    let mut visits = Vec::new();
    let is_road = |lane: &&Lane| {
        [AgentType::Vehicle, AgentType::Cyclist].into_iter().any(|agent_type| lane.users.contain(agent_type))
    };
    for lane in map.lanes().iter().filter(is_road) {
        visit_lane(lane, &mut visits);
    }
    let islands: Vec<_> = map.areas().iter().filter(|area| area.is_keepout).collect();
    visits.retain(|visit| !islands.iter().any(|island| island.contains(visit.position_m)));
    let (origin_m, [cols, rows]) =
        scene::extent(visits.iter().map(|visit| visit.position_m)).ok_or(MapError::NoRoads)?;
    let mut builder = MapBuilder::new(origin_m, rows, cols).ok_or(MapError::TooLarge { rows, cols })?;
    for visit in visits {
        builder.visit(visit.position_m, visit.velocity_mps);
    }
    Ok(builder.build())
}

fn visit_lane(lane: &Lane, visits: &mut Vec<Visit>) {
    let last = lane.centre_m.len() - 1;
    for place in 0..=last {
        let [before, after] = [place.saturating_sub(1), (place + 1).min(last)];
        let direction = direction(lane, before, after);
        let around = [place.saturating_sub(BEND_POINTS), (place + BEND_POINTS).min(last)];
        let speed_mps = bend_speed_mps(lane, around).min(lane.limit_mps.unwrap_or(SPEED_USUAL_MPS));
        let half_m = lane.half_width_m[place];
        let steps = (half_m / ACROSS_M) as i32;
        for step in -steps..=steps {
            let across_m = step as f32 * ACROSS_M;
            let deviations = across_m / (SPREAD * half_m).max(ACROSS_M);
            let visit_count = (VISITS_MAX * (-0.5 * deviations * deviations).exp()).round() as usize;
            let [x, y] = lane.centre_m[place];
            let visit = Visit {
                position_m: [x - direction[1] * across_m, y + direction[0] * across_m],
                velocity_mps: direction.map(|x| x * speed_mps),
            };
            visits.extend(std::iter::repeat_n(visit, visit_count.max(1)));
        }
    }
}

/// Direction of a lane between two of its points.
fn direction(lane: &Lane, from: usize, to: usize) -> [f32; 2] {
    let (from, to) = (lane.centre_m[from], lane.centre_m[to]);
    let (x, y) = (to[0] - from[0], to[1] - from[1]);
    let length_m = x.hypot(y).max(1e-6);
    [x / length_m, y / length_m]
}

/// The speed at which the lateral acceleration in a bend is [`LATERAL_MPS2`], but at least the minimum.
fn bend_speed_mps(lane: &Lane, [from, to]: [usize; 2]) -> f32 {
    if to < from + 2 {
        return f32::INFINITY;
    }
    let [first, last] = [direction(lane, from, from + 1), direction(lane, to - 1, to)];
    let turn_rad = scene::turn(first[1].atan2(first[0]), last[1].atan2(last[0]));
    let bend = turn_rad.abs() / (lane.along_m[to] - lane.along_m[from]).max(1e-3);
    (LATERAL_MPS2 / bend.max(1e-6)).sqrt().max(SPEED_MIN_MPS)
}
