//! Convolutions between maps: forward pass, gradient by the input, gradient by the kernel.
//!
//! Forward pass and gradient by the input are the onboard network's indirect convolution. The gradient by the
//! input reads the gradient of the output through the transposed taps. The gradient by the kernel is a sum of
//! outer products over images and positions.

use nn::kernels::product::{Gather, PANEL, Panels, Product, Taps};
use nn::kernels::{Kernel, Lanes, dispatch};

use super::map::Map;
use crate::net::tensors::{Gradients, Tensors};

/// The square map and kernel of a convolution.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    pub(super) side: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

impl Geometry {
    pub(super) const fn out_side(self) -> usize {
        (self.side + 2 * self.padding - self.kernel) / self.stride + 1
    }

    pub(super) fn taps(self) -> Taps {
        Taps::new(self.side, self.kernel, self.stride, self.padding)
    }
}

/// A convolution with the kernel `name` \[out, in, row, column\].
pub(super) struct Convolution {
    name: String,
    in_channels: usize,
    out_channels: usize,
    kernel_len: usize,
    /// The taps that read any input, and their positions in the kernel.
    taps: Taps,
    places: Vec<usize>,
}

impl Convolution {
    pub(super) fn new(name: String, geometry: Geometry, [in_channels, out_channels]: [usize; 2]) -> Self {
        let (taps, places) = geometry.taps().without_dead();
        Self { name, in_channels, out_channels, kernel_len: geometry.kernel * geometry.kernel, taps, places }
    }

    /// Position of a weight in the kernel.
    fn place(&self, out: usize, tap: usize, c: usize) -> usize {
        (out * self.in_channels + c) * self.kernel_len + self.places[tap]
    }

    pub(super) fn forward(&self, weights: &Tensors, x: &Map) -> Map {
        let kernel = weights.get(&self.name);
        let weight = |out, tap, c| {
            if c < self.in_channels { kernel[self.place(out, tap, c)] } else { 0.0 }
        };
        let panels = Panels::pack([self.out_channels, self.places.len(), x.channels], weight, |_| 0.0);
        let y = Map::zeros(self.taps.out_positions(), x.images, self.out_channels);
        convolve(x, &self.taps, &panels, None, y)
    }

    /// Gradient by the input, added to `sum` if there is one.
    pub(super) fn by_input(&self, weights: &Tensors, dy: &Map, sum: Option<&Map>) -> Map {
        let kernel = weights.get(&self.name);
        let weight = |c, tap, out| {
            if out < self.out_channels { kernel[self.place(out, tap, c)] } else { 0.0 }
        };
        let panels = Panels::pack([self.in_channels, self.places.len(), dy.channels], weight, |_| 0.0);
        let taps = self.taps.transposed();
        let dx = Map::zeros(taps.out_positions(), dy.images, self.in_channels);
        convolve(dy, &taps, &panels, sum, dx)
    }

    /// Adds the gradient by the kernel.
    pub(super) fn by_kernel(&self, gradients: &mut Gradients, x: &Map, dy: &Map) {
        let tap_len = x.channels * dy.channels;
        let mut sums = vec![0.0; self.places.len() * tap_len];
        for position in 0..dy.positions {
            for (tap, source) in self.taps.live_at(position) {
                let sums = &mut sums[tap * tap_len..][..tap_len];
                add_outer([x.position(source), dy.position(position)], [x.channels, dy.channels], sums);
            }
        }
        let kernel = gradients.get_mut(&self.name);
        for out in 0..self.out_channels {
            for tap in 0..self.places.len() {
                for c in 0..self.in_channels {
                    kernel[self.place(out, tap, c)] += sums[tap * tap_len + c * dy.channels + out];
                }
            }
        }
    }
}

fn convolve(x: &Map, taps: &Taps, panels: &Panels, residual: Option<&Map>, mut y: Map) -> Map {
    let zeros = vec![0.0; x.channels];
    let gather = Gather::Taps { taps, image_count: x.images, zeros: &zeros };
    let residual = residual.map(|residual| residual.values.as_slice());
    Product { input: &x.values, gather, panels, residual, relu: false, out: &mut y.values }.run();
    y
}

/// Adds Σ xᵀ y over rows of `x` \[row, in\] and `y` \[row, out\] to `sums` \[in, out\]; `lens` are in and
/// out, multiples of 16.
pub(super) fn add_outer([x, y]: [&[f32]; 2], lens: [usize; 2], sums: &mut [f32]) {
    assert!(lens.iter().all(|len| len.is_multiple_of(PANEL)), "whole panels");
    assert_eq!(sums.len(), lens[0] * lens[1], "sums for each pair");
    dispatch(Outer { x, y, lens, sums });
}

struct Outer<'a> {
    x: &'a [f32],
    y: &'a [f32],
    lens: [usize; 2],
    sums: &'a mut [f32],
}

impl Kernel for Outer<'_> {
    type Output = ();

    /// A tile of sums stays in registers over all rows.
    #[inline(always)]
    fn run<L: Lanes>(mut self, lanes: L) {
        for out in (0..self.lens[1]).step_by(L::LEN) {
            for c in (0..self.lens[0]).step_by(PANEL) {
                if L::LEN == PANEL {
                    self.tile::<L, PANEL>(lanes, c, out);
                } else {
                    self.tile::<L, 8>(lanes, c, out);
                    self.tile::<L, 8>(lanes, c + 8, out);
                }
            }
        }
    }
}

impl Outer<'_> {
    #[inline(always)]
    fn tile<L: Lanes, const R: usize>(&mut self, l: L, c: usize, out: usize) {
        let [in_len, out_len] = self.lens;
        let mut tile = [l.splat(0.0); R];
        for (x, y) in self.x.chunks_exact(in_len).zip(self.y.chunks_exact(out_len)) {
            let y = l.load(&y[out..]);
            for (sum, x) in tile.iter_mut().zip(&x[c..c + R]) {
                *sum = l.fma(l.splat(*x), y, *sum);
            }
        }
        for (r, sum) in tile.into_iter().enumerate() {
            let sums = &mut self.sums[(c + r) * out_len + out..];
            l.store(sums, l.add(l.load(sums), sum));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::tensors::TensorRole;
    use crate::tests::check::{check, values, weighted};

    const NAME: &str = "weight";
    const IMAGES: usize = 5;

    /// Random values with zeros in the padded channels.
    fn map(side: usize, channels: usize, seed: u64) -> Map {
        let mut map = Map::zeros(side * side, IMAGES, channels);
        let filled = values(map.rows() * channels, 1.0, seed);
        for (row, values) in map.values.chunks_exact_mut(map.channels).zip(filled.chunks_exact(channels)) {
            row[..channels].copy_from_slice(values);
        }
        map
    }

    #[test]
    fn gradients_agree_with_differences() {
        let shapes = [
            (5, 3, 1, 1),
            (5, 3, 2, 1),
            (4, 3, 2, 1),
            (2, 3, 1, 1),
            (1, 3, 1, 1),
            (5, 1, 2, 0),
            (1, 1, 1, 0),
        ];
        for (side, kernel, stride, padding) in shapes {
            let geometry = Geometry { side, kernel, stride, padding };
            let [from, to] = [6, 20];
            let convolution = Convolution::new(NAME.to_owned(), geometry, [from, to]);
            let shape = [to, from, kernel, kernel];
            let mut weights = Tensors::default();
            weights.insert(NAME, &shape, values(shape.iter().product(), 1.0, 1), TensorRole::Learned);
            let (x, dy) = (map(side, from, 2), map(geometry.out_side(), to, 3));
            let mut gradients = Gradients::zeros(&weights);
            convolution.by_kernel(&mut gradients, &x, &dy);
            let name = format!("{geometry:?}");
            check(&name, weights.get(NAME), gradients.get_mut(NAME), (0.1, 20), |values| {
                let mut moved = weights.clone();
                moved.insert(NAME, &shape, values.to_vec(), TensorRole::Learned);
                weighted(&convolution.forward(&moved, &x).values, &dy.values)
            });
            let dx = convolution.by_input(&weights, &dy, None);
            check(&name, &x.values, &dx.values, (0.1, 20), |values| {
                let moved = Map { values: values.to_vec(), ..x };
                weighted(&convolution.forward(&weights, &moved).values, &dy.values)
            });
            let sum = convolution.by_input(&weights, &dy, Some(&x));
            let expected: Vec<f32> = dx.values.iter().zip(&x.values).map(|(dx, x)| dx + x).collect();
            assert_eq!(sum.values, expected);
        }
    }
}
