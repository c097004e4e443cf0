//! What the page shows of the next seconds: the ego vehicle's path, and the conflicts.
//!
//! The crate `conflicts` judges the pairs. The ego vehicle has no published forecast: it keeps its speed and its rate
//! of turn.

use std::collections::VecDeque;

use conflicts::Finder;
use wire::tick_view::{Point, TickView};
use wire::{AgentType, Forecast, HORIZON_MAX};

/// Length and width of the ego vehicle, m: a typical car, since no frame contains its size.
pub const EGO_M: Point = [4.6, 1.9];
/// Maximum number of conflicts of a tick.
const CONFLICTS_MAX: usize = 8;
/// Conflicts that the modes foretell with a smaller probability are left out.
const IF_NOBODY_REACTS_MIN: f32 = 0.1;
/// Time between the two poses that give the ego vehicle's speed and rate of turn, and its least and greatest value.
const APART_NS: i64 = 500_000_000;
const APART_RANGE_NS: std::ops::RangeInclusive<i64> = 200_000_000..=800_000_000;

/// A conflict of two agents of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conflict {
    /// Places of the agents in the tick; `None` is the ego vehicle.
    pub places: [Option<usize>; 2],
    /// The probabilities, the time and the place.
    pub pair: conflicts::Pair,
}

/// The next seconds of a tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Foreseen {
    /// The ego vehicle's positions by step, m; empty if its speed is unknown.
    pub ego_path_m: Vec<Point>,
    /// At most eight conflicts. The ego vehicle's come first, then the most probable ones.
    pub conflicts: Vec<Conflict>,
}

/// A pose of the ego vehicle.
#[derive(Clone, Copy, Debug)]
struct Pose {
    stamp_ns: i64,
    position_m: Point,
    heading_rad: f32,
}

/// Foresees the conflicts of successive ticks.
#[derive(Debug, Default)]
pub struct Foresight {
    finder: Finder,
    /// The ego vehicle's poses of the last second.
    poses: VecDeque<Pose>,
}

impl Foresight {
    /// The next seconds of a tick with these forecasts. It costs as much as [`Finder::write`].
    pub fn of(&mut self, view: &TickView, forecasts: &[Forecast]) -> Foreseen {
        let dt_s = view.step_ns as f32 / 1e9;
        let lengths = view.agents.iter().filter_map(|agent| Some(agent.forecast.as_ref()?.best.len()));
        let horizon_len = lengths.max().unwrap_or(HORIZON_MAX);
        let ego = self.ego(view, horizon_len, dt_s);
        let all = forecasts.iter().chain(&ego);
        let mut pairs = self.finder.pairs(all, horizon_len, dt_s, IF_NOBODY_REACTS_MIN);
        // The ego vehicle is behind the agents.
        let is_of_ego = |pair: &conflicts::Pair| pair.places.contains(&forecasts.len());
        pairs.sort_by(|a, b| is_of_ego(b).cmp(&is_of_ego(a)).then(b.probability.total_cmp(&a.probability)));
        pairs.truncate(CONFLICTS_MAX);
        // A forecast without a track is not drawn.
        let place = |at: usize| match forecasts.get(at) {
            None => Some(None),
            Some(of) => view.agents.iter().position(|agent| agent.id == of.id).map(Some),
        };
        let conflict = |pair: conflicts::Pair| {
            let [a, b] = pair.places.map(place);
            let mut places = [a?, b?];
            places.sort_unstable();
            Some(Conflict { places, pair })
        };
        Foreseen {
            ego_path_m: ego.map(|ego| ego.modes[0][..horizon_len].to_vec()).unwrap_or_default(),
            conflicts: pairs.into_iter().filter_map(conflict).collect(),
        }
    }

    /// The ego vehicle's forecast; `None` if it is unknown, or seen for the first time.
    fn ego(&mut self, view: &TickView, horizon_len: usize, dt_s: f32) -> Option<Forecast> {
        let Some((position_m, heading_rad)) = view.ego else {
            self.poses.clear();
            return None;
        };
        let now = Pose { stamp_ns: view.stamp_ns, position_m, heading_rad };
        // Stamps may jump.
        self.poses.retain(|pose| (1..=2 * APART_NS).contains(&(now.stamp_ns - pose.stamp_ns)));
        let apart_ns = |pose: &Pose| now.stamp_ns - pose.stamp_ns;
        let earlier = self.poses.iter().filter(|pose| APART_RANGE_NS.contains(&apart_ns(pose)));
        let earlier = earlier.min_by_key(|pose| (apart_ns(pose) - APART_NS).abs()).copied();
        self.poses.push_back(now);
        Some(steady(&earlier?, &now, horizon_len, dt_s))
    }
}

/// The forecast of a vehicle that keeps the speed and the rate of turn between two poses.
fn steady(earlier: &Pose, now: &Pose, horizon_len: usize, dt_s: f32) -> Forecast {
    let ago_s = (now.stamp_ns - earlier.stamp_ns) as f32 / 1e9;
    let v = [0, 1].map(|axis| (now.position_m[axis] - earlier.position_m[axis]) / ago_s);
    let (sin, cos) = (now.heading_rad - earlier.heading_rad).sin_cos();
    let turn_radps = sin.atan2(cos) / ago_s;
    let ahead = v[0] * now.heading_rad.cos() + v[1] * now.heading_rad.sin();
    let speed_mps = v[0].hypot(v[1]).copysign(ahead);
    let [mut x_m, mut y_m] = now.position_m;
    let mut forecast = Forecast {
        agent_type: AgentType::Vehicle as u32,
        modes_len: 1,
        x_m,
        y_m,
        vx_mps: v[0],
        vy_mps: v[1],
        heading_rad: now.heading_rad,
        length_m: EGO_M[0],
        width_m: EGO_M[1],
        ..Forecast::default()
    };
    forecast.probability[0] = 1.0;
    for (step, point) in forecast.modes[0][..horizon_len].iter_mut().enumerate() {
        let heading_rad = now.heading_rad + turn_radps * dt_s * (step as f32 + 0.5);
        x_m += speed_mps * dt_s * heading_rad.cos();
        y_m += speed_mps * dt_s * heading_rad.sin();
        *point = [x_m, y_m];
    }
    forecast.best = forecast.modes[0];
    forecast
}

#[cfg(test)]
mod tests {
    use wire::{Header, Track};

    use super::*;

    const DT_S: f32 = 0.4;

    /// A car that keeps its velocity.
    fn car(id: u64, position_m: Point, velocity_mps: Point) -> Forecast {
        let mut car = Forecast { id, modes_len: 1, length_m: 4.5, width_m: 1.9, ..Forecast::default() };
        ([car.x_m, car.y_m], [car.vx_mps, car.vy_mps]) = (position_m, velocity_mps);
        car.heading_rad = velocity_mps[1].atan2(velocity_mps[0]);
        car.probability[0] = 1.0;
        for step in 0..HORIZON_MAX {
            let in_s = DT_S * (step + 1) as f32;
            car.modes[0][step] = [0, 1].map(|axis| position_m[axis] + velocity_mps[axis] * in_s);
        }
        car.best = car.modes[0];
        car
    }

    fn foresee(
        foresight: &mut Foresight,
        stamp_ns: i64,
        ego: Option<(Point, f32)>,
        cars: &[Forecast],
    ) -> Foreseen {
        let mut header = Header { step_ns: 400_000_000, ..Header::new(1, 0, stamp_ns) };
        (header.counts.history_len, header.counts.horizon_len) = (1, HORIZON_MAX as u32);
        let tracks: Vec<Track> = cars.iter().map(|car| Track { id: car.id, ..Track::default() }).collect();
        let view = TickView { ego, ..TickView::new((&header, &tracks), (&header, cars)) };
        foresight.of(&view, cars)
    }

    #[test]
    fn the_ego_keeps_its_speed_and_its_rate_of_turn() {
        let mut foresight = Foresight::default();
        // On a circle of 50 m at 10 m/s.
        let pose = |s: f32| {
            let angle = s * 0.2;
            Some(([50.0 * angle.sin(), 50.0 - 50.0 * angle.cos()], angle))
        };
        for k in 0..8_i64 {
            let foreseen = foresee(&mut foresight, k * 80_000_000, pose(k as f32 * 0.08), &[]);
            assert_eq!(foreseen.ego_path_m.is_empty(), k < 3, "tick {k}");
            let Some(end) = foreseen.ego_path_m.last() else { continue };
            let (expected, _) = pose(k as f32 * 0.08 + 4.8).unwrap();
            let apart_m = (end[0] - expected[0]).hypot(end[1] - expected[1]);
            assert!(apart_m < 0.2, "tick {k}: {apart_m} m");
        }
        // A jump of the stamps.
        assert!(foresee(&mut foresight, 0, pose(0.0), &[]).ego_path_m.is_empty());
    }

    #[test]
    fn the_ego_comes_first_and_the_number_is_bounded() {
        let mut foresight = Foresight::default();
        // Cars 7.5 m apart in a column of which each one is faster than the car ahead; the ego follows a slow car.
        let column =
            |x_m: f32| (0..12).map(move |k| car(k, [x_m, 10.0 * k as f32], [0.0, 24.0 - 2.0 * k as f32]));
        let cars: Vec<Forecast> = column(0.0).chain([car(90, [200.0, 3.0], [2.0, 0.0])]).collect();
        foresee(&mut foresight, 0, Some(([180.0, 3.0], 0.0)), &cars);
        let foreseen = foresee(&mut foresight, 500_000_000, Some(([185.0, 3.0], 0.0)), &cars);
        assert_eq!(foreseen.conflicts.len(), CONFLICTS_MAX);
        assert_eq!(foreseen.conflicts[0].places, [None, Some(12)]);
        assert!(foreseen.conflicts[0].pair.if_nobody_reacts > 0.99);
        let rest: Vec<f32> = foreseen.conflicts[1..].iter().map(|of| of.pair.probability).collect();
        assert!(rest.is_sorted_by(|a, b| a >= b), "{rest:?}");
    }
}
