//! Mode selection: the retrieved neighbours' paths that replace modes of a forecast.

use kinematics::MotionKind;
use wire::{HORIZON_MAX, MODES_MAX};

use crate::RETRIEVED_MAX;

/// Maximum number of modes that neighbours' paths replace, by kind of motion.
const SWAPS_MAX: [usize; 2] = [5, 3];
/// Total weight of a forecast's modes, in neighbours of similarity 1, by kind of motion. It is smaller for
/// bicycles, because a road confines them to the paths of others.
const MODES_WEIGHT: [f32; 2] = [4.0, 8.0];
/// Weight of the distance at the last step relative to the mean distance.
const END_WEIGHT: f32 = 0.3;

/// Selects modes, with scratch memory allocated once.
#[derive(Clone, Debug)]
pub struct ModeSelection {
    /// The paths' points by axis and step; the points of all paths at a step are adjacent.
    points_m: [Vec<f32>; 2],
    /// Distances between all pairs of paths, row by row.
    distances_m: Vec<f32>,
    weights: Vec<f32>,
    nearest: Nearest,
    selected: Vec<usize>,
    /// Gain of adding each neighbour's path.
    gains: Vec<f32>,
    /// Loss of removing each selected path.
    losses: Vec<f32>,
    probability: Vec<f32>,
}

/// For each path, its distances to the selected paths.
#[derive(Clone, Debug)]
struct Nearest {
    /// Index of the nearest path among the selected ones.
    places: Vec<u32>,
    /// Distance to the nearest.
    first_m: Vec<f32>,
    /// Distance to the second nearest.
    second_m: Vec<f32>,
}

impl Default for ModeSelection {
    fn default() -> Self {
        let paths_max = MODES_MAX + RETRIEVED_MAX;
        Self {
            points_m: [0, 1].map(|_| Vec::with_capacity(paths_max * HORIZON_MAX)),
            distances_m: Vec::with_capacity(paths_max * paths_max),
            weights: Vec::with_capacity(paths_max),
            nearest: Nearest {
                places: Vec::with_capacity(paths_max),
                first_m: Vec::with_capacity(paths_max),
                second_m: Vec::with_capacity(paths_max),
            },
            selected: Vec::with_capacity(MODES_MAX),
            gains: Vec::with_capacity(RETRIEVED_MAX),
            losses: Vec::with_capacity(MODES_MAX),
            probability: Vec::with_capacity(MODES_MAX),
        }
    }
}

impl ModeSelection {
    /// Selects k of `paths`, where k is the number of modes. A future drawn from all paths by their weights
    /// should be near a selected path. In `paths` the modes come first, with their probabilities. The
    /// neighbours' paths follow, with their own weights.
    ///
    /// This is the weighted k-medoids (k-median) problem:
    ///
    /// ```text
    /// least Σ_i w_i min_{c selected} d(i, c)  w = 4 p of modes (displacements 8 p), of neighbours their own
    ///                                         d = mean over the steps of |Δp| + 0.3 |Δp| at the last
    /// ```
    ///
    /// It is solved greedily by vertex interchange (Teitz and Bart), starting from the modes:
    ///
    /// 1. Add the neighbour's path that lowers the sum most.
    /// 2. Remove the selected path whose removal then raises the sum least.
    /// 3. Repeat while the sum falls, at most five times, or three times for displacements.
    ///
    /// A mode's probability is the share of the weights that are nearest to it.
    ///
    /// # Panics
    /// If the number of paths differs from the number of weights, or a path has more steps than a payload
    /// holds.
    pub fn select(
        &mut self,
        kind: MotionKind,
        paths: &[[[f32; 2]; HORIZON_MAX]],
        horizon_len: usize,
        probability: &[f32],
        neighbours: impl Iterator<Item = f32>,
    ) {
        let modes_len = probability.len();
        self.weights.clear();
        let modes_weight = MODES_WEIGHT[kind as usize];
        self.weights.extend(probability.iter().map(|p| modes_weight * p).chain(neighbours));
        assert_eq!(self.weights.len(), paths.len(), "a weight for each path");
        self.measure(paths, horizon_len);
        self.selected.clear();
        self.selected.extend(0..modes_len);
        for _ in 0..SWAPS_MAX[kind as usize].min(modes_len.saturating_sub(1)) {
            self.find_nearest();
            if !self.swap(modes_len) {
                break;
            }
        }
        self.find_nearest();
        self.probability.clear();
        self.probability.resize(modes_len, 0.0);
        let total: f32 = self.weights.iter().sum();
        for (place, weight) in self.nearest.places.iter().zip(&self.weights) {
            self.probability[*place as usize] += weight / total.max(f32::MIN_POSITIVE);
        }
    }

    /// For every mode, the path that was selected in its place (itself or a neighbour's) and its probability.
    pub fn selected(&self) -> impl Iterator<Item = (usize, f32)> {
        self.selected.iter().copied().zip(self.probability.iter().copied())
    }

    fn measure(&mut self, paths: &[[[f32; 2]; HORIZON_MAX]], horizon_len: usize) {
        let len = paths.len();
        for (axis, points_m) in self.points_m.iter_mut().enumerate() {
            points_m.clear();
            (0..horizon_len).for_each(|step| points_m.extend(paths.iter().map(|path| path[step][axis])));
        }
        self.distances_m.clear();
        self.distances_m.resize(len * len, 0.0);
        let [xs, ys] = self.points_m.each_ref().map(|points_m| points_m.chunks_exact(len.max(1)));
        for (step, (xs, ys)) in xs.zip(ys).enumerate() {
            let last = if step + 1 == horizon_len { END_WEIGHT } else { 0.0 };
            let weight = 1.0 / horizon_len as f32 + last;
            // From each path to all later ones.
            for (place, row) in self.distances_m.chunks_exact_mut(len).enumerate() {
                let (x, y, after) = (xs[place], ys[place], place + 1..);
                let others = xs[after.clone()].iter().zip(&ys[after.clone()]);
                for (sum, (x_there, y_there)) in row[after].iter_mut().zip(others) {
                    let (dx, dy) = (x_there - x, y_there - y);
                    *sum += weight * (dx * dx + dy * dy).sqrt();
                }
            }
        }
        for row in 0..len {
            (0..row).for_each(|column| {
                self.distances_m[row * len + column] = self.distances_m[column * len + row];
            });
        }
    }

    fn find_nearest(&mut self) {
        let len = self.weights.len();
        self.nearest.clear(len);
        for (place, &path) in self.selected.iter().enumerate() {
            self.nearest.take_in(place as u32, &self.distances_m[path * len..(path + 1) * len]);
        }
    }

    /// Replaces the selected path of least loss by the neighbour's path of greatest gain. Returns `false` if
    /// the sum does not fall.
    fn swap(&mut self, modes_len: usize) -> bool {
        let Self { distances_m, weights, nearest, selected, gains, losses, .. } = self;
        let len = weights.len();
        // The sums of different paths are independent and computed in parallel lanes.
        gains.clear();
        gains.resize(len - modes_len, 0.0);
        for ((row, first_m), weight) in
            distances_m.chunks_exact(len.max(1)).zip(&nearest.first_m).zip(&*weights)
        {
            for (gain, apart_m) in gains.iter_mut().zip(&row[modes_len..]) {
                *gain += weight * (first_m - apart_m).max(0.0);
            }
        }
        let Some((entering, gain)) = best(gains, |other, best| other > best) else { return false };
        let entering = modes_len + entering;
        losses.clear();
        losses.resize(selected.len(), 0.0);
        let near = nearest.places.iter().zip(&nearest.first_m).zip(&nearest.second_m);
        let row = &distances_m[entering * len..(entering + 1) * len];
        for (((&place, first_m), second_m), (apart_m, weight)) in near.zip(row.iter().zip(&*weights)) {
            losses[place as usize] += weight * (second_m.min(*apart_m) - first_m.min(*apart_m));
        }
        match best(losses, |other, best| other < best) {
            Some((place, loss)) if gain > loss => {
                selected[place] = entering;
                true
            }
            _ => false,
        }
    }
}

/// The first of the best values.
fn best(values: &[f32], better: impl Fn(f32, f32) -> bool) -> Option<(usize, f32)> {
    let places = values.iter().copied().enumerate();
    places.reduce(|best, other| if better(other.1, best.1) { other } else { best })
}

impl Nearest {
    /// Resets to `len` paths without any near path.
    fn clear(&mut self, len: usize) {
        self.places.clear();
        self.places.resize(len, 0);
        for distances_m in [&mut self.first_m, &mut self.second_m] {
            distances_m.clear();
            distances_m.resize(len, f32::INFINITY);
        }
    }

    /// Adds a selected path, given its distances to all paths.
    fn take_in(&mut self, selected: u32, distances_m: &[f32]) {
        let own = self.places.iter_mut().zip(&mut self.first_m).zip(&mut self.second_m);
        for (((place, first_m), second_m), &apart_m) in own.zip(distances_m) {
            let nearer = apart_m < *first_m;
            *second_m = if nearer { *first_m } else { second_m.min(apart_m) };
            *first_m = if nearer { apart_m } else { *first_m };
            *place = if nearer { selected } else { *place };
        }
    }
}
