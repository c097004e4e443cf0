//! Which of the remembered paths stand in for modes of a forecast.

use wire::HORIZON_MAX;

use super::Gait;

/// Modes that remembered paths may take the place of, driving and walking.
const SWAPS_MAX: [usize; 2] = [5, 3];
/// As many remembered paths as the modes of a forecast together are worth, driving and walking: roads leave less choice.
const WORTH: [f32; 2] = [4.0, 8.0];
/// What the distance at the end counts beside the mean distance.
const END: f32 = 0.3;

/// Chooses, and keeps its memory from one forecast to the next.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// The paths' points by axis, step by step: those of all paths beside one another.
    points_m: [Vec<f32>; 2],
    /// Distances between all paths, row by row.
    distances_m: Vec<f32>,
    weights: Vec<f32>,
    /// The nearest chosen path of each, and the two least distances to chosen ones.
    nearest: Vec<Nearest>,
    chosen: Vec<usize>,
    probability: Vec<f32>,
}

/// How near a path is to those that are chosen.
#[derive(Clone, Copy, Debug)]
struct Nearest {
    place: usize,
    first_m: f32,
    second_m: f32,
}

impl Choice {
    /// Chooses as many of `paths` as there are modes, so that a future drawn from all of them, by their weights, has a chosen one
    /// near it: the modes come first, with their probabilities, remembered paths follow, with the weights of their moments.
    ///
    /// ```text
    /// least Σ_i w_i min_{c chosen} d(i, c)      w = 4 p of modes, walking 8 p, of remembered paths their own
    ///                                           d = mean over the steps of |Δp| + 0.3 |Δp| at the last
    /// ```
    ///
    /// Greedily, from the modes on: the remembered path that helps most takes the place of the mode that is missed least, at most
    /// five times, walking three.
    ///
    /// # Panics
    /// Where there are not as many paths as weights, or steps than a payload holds.
    pub fn choose(
        &mut self,
        gait: Gait,
        paths: &[[[f32; 2]; HORIZON_MAX]],
        horizon_len: usize,
        probability: &[f32],
        remembered: impl Iterator<Item = f32>,
    ) {
        let modes_len = probability.len();
        self.weights.clear();
        let worth = WORTH[gait as usize];
        self.weights.extend(probability.iter().map(|p| worth * p).chain(remembered));
        assert_eq!(self.weights.len(), paths.len(), "a weight for each path");
        self.measure(paths, horizon_len);
        self.chosen.clear();
        self.chosen.extend(0..modes_len);
        for _ in 0..SWAPS_MAX[gait as usize].min(modes_len.saturating_sub(1)) {
            self.find_nearest();
            if !self.swap(modes_len) {
                break;
            }
        }
        self.find_nearest();
        self.probability.clear();
        self.probability.resize(modes_len, 0.0);
        let total: f32 = self.weights.iter().sum();
        for (near, weight) in self.nearest.iter().zip(&self.weights) {
            self.probability[near.place] += weight / total.max(f32::MIN_POSITIVE);
        }
    }

    /// For every mode the path that was chosen in its place: itself, or a remembered one; and its probability.
    pub fn chosen(&self) -> impl Iterator<Item = (usize, f32)> {
        self.chosen.iter().copied().zip(self.probability.iter().copied())
    }

    fn measure(&mut self, paths: &[[[f32; 2]; HORIZON_MAX]], horizon_len: usize) {
        let len = paths.len();
        for (axis, points_m) in self.points_m.iter_mut().enumerate() {
            points_m.clear();
            points_m.extend((0..horizon_len).flat_map(|step| paths.iter().map(move |path| path[step][axis])));
        }
        self.distances_m.clear();
        self.distances_m.resize(len * len, 0.0);
        let [xs, ys] = self.points_m.each_ref().map(|points_m| points_m.chunks_exact(len.max(1)));
        for (step, (xs, ys)) in xs.zip(ys).enumerate() {
            let last = if step + 1 == horizon_len { END } else { 0.0 };
            let weight = 1.0 / horizon_len as f32 + last;
            for (row, (x, y)) in self.distances_m.chunks_exact_mut(len).zip(xs.iter().zip(ys)) {
                for (sum, (x_there, y_there)) in row.iter_mut().zip(xs.iter().zip(ys)) {
                    let (dx, dy) = (x_there - x, y_there - y);
                    *sum += weight * (dx * dx + dy * dy).sqrt();
                }
            }
        }
    }

    fn find_nearest(&mut self) {
        let len = self.weights.len();
        self.nearest.clear();
        for row in self.distances_m.chunks_exact(len.max(1)) {
            let mut near = Nearest { place: 0, first_m: f32::INFINITY, second_m: f32::INFINITY };
            for (place, &path) in self.chosen.iter().enumerate() {
                let apart = row[path];
                if apart < near.first_m {
                    near = Nearest { place, first_m: apart, second_m: near.first_m };
                } else {
                    near.second_m = near.second_m.min(apart);
                }
            }
            self.nearest.push(near);
        }
    }

    /// Puts the remembered path that helps most in the place of the chosen one that is missed least; false where that does not
    /// help.
    fn swap(&mut self, modes_len: usize) -> bool {
        let len = self.weights.len();
        let to = |path: usize| &self.distances_m[path * len..(path + 1) * len];
        let gain = |path: usize| -> f32 {
            let rows = to(path).iter().zip(&self.nearest).zip(&self.weights);
            rows.map(|((apart, near), weight)| weight * (near.first_m - apart).max(0.0)).sum()
        };
        let gains = (modes_len..len).map(|path| (path, gain(path)));
        let Some((entering, gain)) = gains.reduce(|best, other| if other.1 > best.1 { other } else { best })
        else {
            return false;
        };
        let loss = |place: usize| -> f32 {
            let rows = to(entering).iter().zip(&self.nearest).zip(&self.weights);
            let left = rows.filter(|((_, near), _)| near.place == place);
            left.map(|((apart, near), weight)| {
                weight * (near.second_m.min(*apart) - near.first_m.min(*apart))
            })
            .sum()
        };
        let losses = (0..self.chosen.len()).map(|place| (place, loss(place)));
        match losses.reduce(|best, other| if other.1 < best.1 { other } else { best }) {
            Some((place, loss)) if gain > loss => {
                self.chosen[place] = entering;
                true
            }
            _ => false,
        }
    }
}
