//! Activations and their gradients, and the two poolings.

use nn::kernels::product::{PANEL, Taps};

/// Activations of a batch, \[position, image, channel\]; channels are padded to whole panels with zeros.
#[derive(Clone, Debug)]
pub(super) struct Map {
    pub(super) positions: usize,
    pub(super) images: usize,
    pub(super) channels: usize,
    pub(super) values: Vec<f32>,
}

impl Map {
    /// Zeros for this number of channels, padded.
    pub(super) fn zeros(positions: usize, images: usize, channels: usize) -> Self {
        let channels = channels.next_multiple_of(PANEL);
        Self { positions, images, channels, values: vec![0.0; positions * images * channels] }
    }

    /// Zeros of the same shape.
    pub(super) fn like(&self) -> Self {
        Self { values: vec![0.0; self.values.len()], ..*self }
    }

    /// Positions of all images.
    pub(super) const fn rows(&self) -> usize {
        self.positions * self.images
    }

    /// The channels of all rows, sixteen at a time.
    pub(super) fn panels(&self) -> &[[f32; PANEL]] {
        self.values.as_chunks().0
    }

    pub(super) fn panels_mut(&mut self) -> &mut [[f32; PANEL]] {
        self.values.as_chunks_mut().0
    }

    /// The \[image, channel\] values of a position.
    pub(super) fn position(&self, position: usize) -> &[f32] {
        let len = self.images * self.channels;
        &self.values[position * len..][..len]
    }

    pub(super) fn position_mut(&mut self, position: usize) -> &mut [f32] {
        let len = self.images * self.channels;
        &mut self.values[position * len..][..len]
    }
}

/// Max-pool over the taps. The input is not negative, so padding counts as 0.
pub(super) fn max_pool(x: &Map, taps: &Taps) -> Map {
    let mut y = Map::zeros(taps.out_positions(), x.images, x.channels);
    for position in 0..y.positions {
        let most = y.position_mut(position);
        for (_, source) in taps.live_at(position) {
            most.iter_mut().zip(x.position(source)).for_each(|(most, x)| *most = most.max(*x));
        }
    }
    y
}

/// The backward pass of [`max_pool`]: the gradient of a maximum goes to the first tap that has it.
pub(super) fn max_pool_backward([x, y]: [&Map; 2], taps: &Taps, mut dy: Map) -> Map {
    let mut dx = x.like();
    for position in 0..y.positions {
        let (most, left) = (y.position(position), dy.position_mut(position));
        for (_, source) in taps.live_at(position) {
            let sums = dx.position_mut(source).iter_mut();
            for (((sum, x), most), left) in sums.zip(x.position(source)).zip(most).zip(&mut *left) {
                if x == most {
                    *sum += std::mem::take(left);
                }
            }
        }
    }
    dx
}

/// Mean over the positions: a map with one position.
pub(super) fn average(x: &Map) -> Map {
    let mut means = Map::zeros(1, x.images, x.channels);
    for position in 0..x.positions {
        means.values.iter_mut().zip(x.position(position)).for_each(|(sum, x)| *sum += x);
    }
    let share = 1.0 / x.positions as f32;
    means.values.iter_mut().for_each(|sum| *sum *= share);
    means
}

/// The backward pass of [`average`] over this number of positions.
pub(super) fn average_backward(d_means: &Map, positions: usize) -> Map {
    let share = 1.0 / positions as f32;
    let dx: Vec<f32> = d_means.values.iter().map(|mean| share * mean).collect();
    Map { positions, values: dx.repeat(positions), ..*d_means }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::check::{check, values, weighted};

    fn map(positions: usize, seed: u64) -> Map {
        let empty = Map::zeros(positions, 3, PANEL);
        Map { values: values(empty.values.len(), 1.0, seed).iter().map(|x| x.abs()).collect(), ..empty }
    }

    #[test]
    fn gradients_of_the_poolings_agree_with_differences() {
        let (x, dy) = (map(25, 1), map(9, 2));
        let taps = Taps::new(5, 3, 2, 1);
        let y = max_pool(&x, &taps);
        let dx = max_pool_backward([&x, &y], &taps, dy.clone());
        check("maximum", &x.values, &dx.values, (1e-4, 30), |values| {
            weighted(&max_pool(&Map { values: values.to_vec(), ..x }, &taps).values, &dy.values)
        });
        let dy = map(1, 3);
        let dx = average_backward(&dy, x.positions);
        check("mean", &x.values, &dx.values, (1e-1, 30), |values| {
            weighted(&average(&Map { values: values.to_vec(), ..x }).values, &dy.values)
        });
    }

    #[test]
    fn the_first_of_equal_maxima_has_the_gradient() {
        let mut x = Map::zeros(9, 1, PANEL);
        x.values.fill(1.0);
        let taps = Taps::new(3, 3, 2, 1);
        let y = max_pool(&x, &taps);
        let dx = max_pool_backward([&x, &y], &taps, y.clone());
        let of_channel: Vec<f32> = dx.values.iter().step_by(PANEL).copied().collect();
        // Windows of 2 × 2 at the corners of 3 × 3 cells.
        assert_eq!(of_channel, [1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
