//! Which of the remembered paths stand in for modes of a forecast.

use wire::HORIZON_MAX;

/// Modes that remembered paths may take the place of.
const SWAPS_MAX: usize = 3;
/// As many remembered paths as the modes of a forecast together are worth.
const WORTH: f32 = 8.0;
/// What the distance at the end counts beside the mean distance.
const END: f32 = 0.3;

/// Chooses, and keeps its memory from one forecast to the next.
#[derive(Clone, Debug, Default)]
pub struct Choice {
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
    /// least Σ_i w_i min_{c chosen} d(i, c)      w = 8 p of modes, of remembered paths their own
    ///                                           d = mean over the steps of |Δp| + 0.3 |Δp| at the last
    /// ```
    ///
    /// Greedily, from the modes on: the remembered path that helps most takes the place of the mode that is missed least, at most
    /// three times.
    ///
    /// # Panics
    /// Where there are not as many paths as weights, or steps than a payload holds.
    pub fn choose(
        &mut self,
        paths: &[[[f32; 2]; HORIZON_MAX]],
        horizon_len: usize,
        probability: &[f32],
        remembered: impl Iterator<Item = f32>,
    ) {
        let modes_len = probability.len();
        self.weights.clear();
        self.weights.extend(probability.iter().map(|p| WORTH * p).chain(remembered));
        assert_eq!(self.weights.len(), paths.len(), "a weight for each path");
        self.measure(paths, horizon_len);
        self.chosen.clear();
        self.chosen.extend(0..modes_len);
        for _ in 0..SWAPS_MAX.min(modes_len.saturating_sub(1)) {
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
        self.distances_m.clear();
        self.distances_m.resize(len * len, 0.0);
        for i in 0..len {
            for j in 0..i {
                let apart = distance_m(&paths[i][..horizon_len], &paths[j][..horizon_len]);
                self.distances_m[i * len + j] = apart;
                self.distances_m[j * len + i] = apart;
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

fn distance_m(a: &[[f32; 2]], b: &[[f32; 2]]) -> f32 {
    let apart = |(a, b): (&[f32; 2], &[f32; 2])| {
        let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
        (dx * dx + dy * dy).sqrt()
    };
    let sum: f32 = a.iter().zip(b).map(apart).sum();
    let last = a.last().zip(b.last()).map_or(0.0, apart);
    sum / a.len().max(1) as f32 + END * last
}
