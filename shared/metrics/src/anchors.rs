use scene::{AgentType, State, agent_frame};

use crate::{Point, constant_velocity, kmeans};

/// Anchors per speed bin.
pub const ANCHORS: usize = 20;
/// Speed bins of the anchors.
pub const SPEED_BINS: usize = 8;
/// Bounds of the speed bins of vehicles and cyclists.
pub const VEHICLE_SPEED_CUTS_MPS: [f32; SPEED_BINS - 1] = [0.5, 1.5, 3.0, 4.5, 6.0, 7.5, 9.5];
/// Bounds of the speed bins of pedestrians.
pub const PEDESTRIAN_SPEED_CUTS_MPS: [f32; SPEED_BINS - 1] = [0.2, 0.5, 0.8, 1.0, 1.2, 1.4, 1.7];

/// A bin with fewer windows takes the anchors of its nearest neighbour.
const WINDOWS_MIN: usize = 60;
const KMEANS_ITERATIONS: usize = 50;

/// Bounds of the speed bins for an agent type.
#[must_use]
pub const fn speed_cuts_mps(agent_type: AgentType) -> [f32; SPEED_BINS - 1] {
    match agent_type {
        AgentType::Vehicle | AgentType::Cyclist => VEHICLE_SPEED_CUTS_MPS,
        AgentType::Pedestrian => PEDESTRIAN_SPEED_CUTS_MPS,
    }
}

/// The history and future of an agent at one time.
#[derive(Clone, Copy, Debug)]
pub struct Window<'a> {
    /// States up to this time, oldest first.
    pub history: &'a [Option<State>],
    /// Positions after this time.
    pub future: &'a [Option<Point>],
}

/// A table of typical residuals of constant velocity, 20 per speed bin. This is the simplest multi-modal
/// forecast.
///
/// A residual is a window's future minus its constant-velocity forecast, in the agent frame of the newest
/// state. Every residual is also counted mirrored about the heading. The anchors are the k-means centres of
/// each speed bin. A forecast is constant velocity plus one anchor of the bin.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchors {
    dt_s: f32,
    horizon: usize,
    speed_cuts_mps: [f32; SPEED_BINS - 1],
    /// One per speed bin. All bins are equal if none had enough windows.
    bins: Vec<Bin>,
}

#[derive(Clone, Debug, PartialEq)]
struct Bin {
    /// Residuals, most likely first.
    residuals: Vec<Vec<Point>>,
    probability: Vec<f32>,
}

impl Anchors {
    /// Clusters the residuals of the windows whose newest state and whole future are known.
    ///
    /// The future has `horizon` steps, `dt_s` apart. Returns `None` if no window qualifies. The same windows
    /// in the same order give the same anchors.
    #[must_use]
    pub fn fit(
        windows: &[Window<'_>],
        dt_s: f32,
        horizon: usize,
        speed_cuts_mps: [f32; SPEED_BINS - 1],
        seed: u64,
    ) -> Option<Self> {
        let mut residuals: [Vec<f32>; SPEED_BINS] = std::array::from_fn(|_| Vec::new());
        for window in windows {
            if let Some((speed_mps, residual)) = residual(window, dt_s, horizon) {
                let bin = &mut residuals[speed_bin(&speed_cuts_mps, speed_mps)];
                bin.extend(residual.iter().flatten());
                bin.extend(residual.iter().flat_map(|[x, y]| [*x, -*y]));
            }
        }
        let row = horizon * 2;
        let enough = |bin: &[f32]| bin.len() >= 2 * WINDOWS_MIN * row;
        // If no bin has enough windows, all windows form one bin.
        if !residuals.iter().any(|bin| enough(bin)) {
            let all = residuals.concat();
            let bin = (!all.is_empty()).then(|| Bin::cluster(&all, row, seed))?;
            return Some(Self { dt_s, horizon, speed_cuts_mps, bins: vec![bin; SPEED_BINS] });
        }
        let own: Vec<Option<Bin>> =
            residuals.iter().map(|bin| enough(bin).then(|| Bin::cluster(bin, row, seed))).collect();
        let bins = (0..SPEED_BINS).map(|i| nearest_bin(&own, i)).collect::<Option<Vec<Bin>>>()?;
        Some(Self { dt_s, horizon, speed_cuts_mps, bins })
    }

    /// The forecasts of an agent, most likely first. Returns `None` if the newest state is absent.
    #[must_use]
    pub fn predict(&self, history: &[Option<State>]) -> Option<Vec<Vec<Point>>> {
        let base = constant_velocity(history, self.dt_s, self.horizon)?;
        let frame = agent_frame(history)?;
        let bin = self.bin(history)?;
        let shifted = |residual: &Vec<Point>| {
            let steps = base.iter().zip(residual);
            steps.map(|(b, r)| (*b, frame.rotate_out(*r))).map(|(b, r)| [b[0] + r[0], b[1] + r[1]]).collect()
        };
        Some(bin.residuals.iter().map(shifted).collect())
    }

    /// The probability of each forecast of [`Anchors::predict`]: the share of training residuals in its
    /// cluster.
    #[must_use]
    pub fn probability(&self, history: &[Option<State>]) -> Option<&[f32]> {
        self.bin(history).map(|bin| &bin.probability[..])
    }

    fn bin(&self, history: &[Option<State>]) -> Option<&Bin> {
        let newest = (*history.last()?)?;
        Some(&self.bins[speed_bin(&self.speed_cuts_mps, newest.speed_mps())])
    }
}

impl Bin {
    fn cluster(residuals: &[f32], row: usize, seed: u64) -> Self {
        let found = kmeans(residuals, row, ANCHORS, seed, KMEANS_ITERATIONS);
        let mut order: Vec<usize> = (0..ANCHORS).collect();
        order.sort_by_key(|&k| std::cmp::Reverse(found.sizes[k]));
        let point_count = (residuals.len() / row) as f32;
        let residual = |k: &usize| found.centres[k * row..][..row].as_chunks::<2>().0.to_vec();
        Self {
            residuals: order.iter().map(residual).collect(),
            probability: order.iter().map(|&k| found.sizes[k] as f32 / point_count).collect(),
        }
    }
}

fn speed_bin(cuts_mps: &[f32], speed_mps: f32) -> usize {
    cuts_mps.iter().filter(|cut| speed_mps >= **cut).count()
}

fn nearest_bin(bins: &[Option<Bin>], wanted: usize) -> Option<Bin> {
    let by_distance = |i: &usize| i.abs_diff(wanted);
    (0..bins.len()).filter(|&i| bins[i].is_some()).min_by_key(by_distance).and_then(|i| bins[i].clone())
}

/// A window's speed, and its residual from constant velocity in the agent frame.
fn residual(window: &Window<'_>, dt_s: f32, horizon: usize) -> Option<(f32, Vec<Point>)> {
    let base = constant_velocity(window.history, dt_s, horizon)?;
    let frame = agent_frame(window.history)?;
    let newest = (*window.history.last()?)?;
    let future: Vec<Point> = window.future.get(..horizon)?.iter().copied().collect::<Option<_>>()?;
    let steps = future.iter().zip(&base).map(|(f, b)| [f[0] - b[0], f[1] - b[1]]);
    let residual = steps.map(|residual| frame.rotate_into(residual)).collect();
    Some((newest.speed_mps(), residual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{displacement, min_displacement};

    const DT_S: f32 = 0.4;
    const HORIZON: usize = 4;

    /// An agent with `heading` and `speed` that turns at `rate` after its newest state.
    fn window(heading: f32, speed: f32, rate: f32) -> (Vec<Option<State>>, Vec<Option<Point>>) {
        let velocity = [speed * heading.cos(), speed * heading.sin()];
        let at = |t: f32| {
            Some(State {
                position_m: [3.0 + velocity[0] * t, velocity[1] * t],
                velocity_mps: velocity,
                heading_rad: heading,
            })
        };
        let history = vec![at(-DT_S), at(0.0)];
        let mut position = [3.0, 0.0];
        let future = (1..=HORIZON)
            .map(|k| {
                let course = heading + rate * DT_S * k as f32;
                position =
                    [position[0] + speed * course.cos() * DT_S, position[1] + speed * course.sin() * DT_S];
                Some(position)
            })
            .collect();
        (history, future)
    }

    fn fitted(speeds: &[f32]) -> Anchors {
        let mut owned = Vec::new();
        for i in 0..200 {
            let rate = [0.0, 0.5][i % 2];
            owned.push(window(i as f32 * 0.1, speeds[i % speeds.len()], rate));
        }
        let windows: Vec<Window<'_>> =
            owned.iter().map(|(history, future)| Window { history, future }).collect();
        Anchors::fit(&windows, DT_S, HORIZON, VEHICLE_SPEED_CUTS_MPS, 7).expect("windows")
    }

    #[test]
    fn anchors_cover_training_futures_rotated_and_mirrored() {
        let anchors = fitted(&[5.0]);
        for (heading, rate) in [(0.3, 0.0), (-2.0, 0.5), (1.0, -0.5)] {
            let (history, future) = window(heading, 5.0, rate);
            let modes = anchors.predict(&history).expect("present");
            assert_eq!(modes.len(), ANCHORS);
            let ade_m = min_displacement(&modes, &future).ade_m.expect("known");
            assert!(ade_m < 1e-3, "heading {heading}, rate {rate}: {ade_m}");
        }
    }

    #[test]
    fn probabilities_are_sorted_and_sum_to_one() {
        let anchors = fitted(&[5.0]);
        let (history, straight) = window(0.0, 5.0, 0.0);
        let modes = anchors.predict(&history).expect("present");
        let probability = anchors.probability(&history).expect("present");
        assert!((probability.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        assert!(probability.is_sorted_by(|a, b| a >= b));
        let near = |mode: &[Point]| displacement(mode, &straight).ade_m.expect("known") < 1e-3;
        let straight_share: f32 =
            modes.iter().zip(probability).filter(|(m, _)| near(m)).map(|(_, p)| p).sum();
        assert!((straight_share - 0.5).abs() < 1e-5, "half of the windows went straight: {probability:?}");
    }

    #[test]
    fn a_bin_without_windows_has_its_neighbours_anchors() {
        let anchors = fitted(&[5.0]);
        let slow = anchors.predict(&window(0.0, 0.2, 0.0).0).expect("present");
        let fast = anchors.predict(&window(0.0, 5.0, 0.0).0).expect("present");
        let residual = |modes: &[Vec<Point>], speed: f32| modes[5][3][0] - (3.0 + speed * 4.0 * DT_S);
        assert!((residual(&slow, 0.2) - residual(&fast, 5.0)).abs() < 1e-4);
    }

    #[test]
    fn few_windows_share_one_bin_and_none_fit_nothing() {
        let (history, future) = window(0.0, 5.0, 0.5);
        let windows = [Window { history: &history, future: &future }];
        let anchors = Anchors::fit(&windows, DT_S, HORIZON, VEHICLE_SPEED_CUTS_MPS, 1).expect("one window");
        assert!(
            min_displacement(&anchors.predict(&history).expect("present"), &future).ade_m.expect("known")
                < 1e-4
        );
        let unknown = [Window { history: &history, future: &[None; HORIZON] }];
        assert_eq!(Anchors::fit(&unknown, DT_S, HORIZON, VEHICLE_SPEED_CUTS_MPS, 1), None);
    }

    #[test]
    fn speed_bins_include_their_lower_bound() {
        assert_eq!(speed_bin(&VEHICLE_SPEED_CUTS_MPS, 0.0), 0);
        assert_eq!(speed_bin(&VEHICLE_SPEED_CUTS_MPS, 0.5), 1);
        assert_eq!(speed_bin(&VEHICLE_SPEED_CUTS_MPS, 99.0), 7);
    }
}
