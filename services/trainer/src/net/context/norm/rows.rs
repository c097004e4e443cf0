//! The passes of a batch norm over the rows \[row, panel\] of a map.

use nn::kernels::product::PANEL;
use nn::kernels::{Kernel, Lanes};

/// Sixteen channels of a row.
pub(super) type Panel = [f32; PANEL];
/// Sums over all rows, of sixteen channels.
pub(super) type Sums = [f64; PANEL];

/// Rows that are summed in single precision.
const BLOCK: usize = 256;

/// Sums over rows, for each panel of channels, of the K `terms` of (panel, place).
#[inline(always)]
fn sum<const K: usize>(
    places_len: usize,
    panels_len: usize,
    mut terms: impl FnMut(usize, usize) -> [Panel; K],
) -> Vec<[Sums; K]> {
    let mut totals = vec![[[0.0; PANEL]; K]; panels_len];
    for (panel, totals) in totals.iter_mut().enumerate() {
        for block in (panel..places_len).step_by(panels_len * BLOCK) {
            let mut sums = [[0.0_f32; PANEL]; K];
            let end = places_len.min(block + panels_len * BLOCK);
            for place in (block..end).step_by(panels_len) {
                for (sums, terms) in sums.iter_mut().zip(terms(panel, place)) {
                    for c in 0..PANEL {
                        sums[c] += terms[c];
                    }
                }
            }
            for (total, sum) in totals.as_flattened_mut().iter_mut().zip(sums.as_flattened()) {
                *total += f64::from(*sum);
            }
        }
    }
    totals
}

/// Σ x.
pub(super) struct Total<'a> {
    pub(super) x: &'a [Panel],
    pub(super) panels_len: usize,
}

impl Kernel for Total<'_> {
    type Output = Vec<[Sums; 1]>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        sum(self.x.len(), self.panels_len, |_, place| [self.x[place]])
    }
}

/// Σ (x − mean)².
pub(super) struct Spread<'a> {
    pub(super) x: &'a [Panel],
    pub(super) mean: &'a [Panel],
}

impl Kernel for Spread<'_> {
    type Output = Vec<[Sums; 1]>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        sum(self.x.len(), self.mean.len(), |panel, place| {
            let (x, mean) = (&self.x[place], &self.mean[panel]);
            let mut squares = [0.0; PANEL];
            for c in 0..PANEL {
                squares[c] = (x[c] - mean[c]) * (x[c] - mean[c]);
            }
            [squares]
        })
    }
}

/// Σ dy and Σ dy (x − mean), after `dy` is set to zero where `rectified` is.
pub(super) struct Slopes<'a> {
    pub(super) x: &'a [Panel],
    pub(super) mean: &'a [Panel],
    pub(super) rectified: Option<&'a [Panel]>,
    pub(super) dy: &'a mut [Panel],
}

impl Kernel for Slopes<'_> {
    type Output = Vec<[Sums; 2]>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        let places_len = self.x.len();
        assert!(self.dy.len() == places_len && self.rectified.is_none_or(|y| y.len() == places_len));
        sum(places_len, self.mean.len(), |panel, place| {
            let (x, mean, dy) = (&self.x[place], &self.mean[panel], &mut self.dy[place]);
            if let Some(rectified) = self.rectified {
                let y = &rectified[place];
                for c in 0..PANEL {
                    dy[c] = if y[c] > 0.0 { dy[c] } else { 0.0 };
                }
            }
            let mut products = [0.0; PANEL];
            for c in 0..PANEL {
                products[c] = dy[c] * (x[c] - mean[c]);
            }
            [*dy, products]
        })
    }
}

/// out = a x + b + z, and no less than `floor`; `lines` are a and b.
pub(super) struct Line<'a> {
    pub(super) lines: [&'a [Panel]; 2],
    pub(super) x: &'a [Panel],
    pub(super) z: Option<&'a [Panel]>,
    pub(super) floor: f32,
    pub(super) out: &'a mut [Panel],
}

impl Kernel for Line<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { lines: [a, b], x, z, floor, out } = self;
        assert!(x.len() == out.len() && z.is_none_or(|z| z.len() == out.len()) && a.len() == b.len());
        let zeros = [0.0; PANEL];
        let panels_len = a.len();
        for (row, out) in out.chunks_exact_mut(panels_len).enumerate() {
            let x = &x[row * panels_len..][..panels_len];
            let z = z.map(|z| &z[row * panels_len..][..panels_len]);
            for panel in 0..panels_len {
                let (a, b, x, out) = (&a[panel], &b[panel], &x[panel], &mut out[panel]);
                let z = z.map_or(&zeros, |z| &z[panel]);
                for c in 0..PANEL {
                    out[c] = (a[c] * x[c] + b[c] + z[c]).max(floor);
                }
            }
        }
    }
}

/// out = a y + b x + c; `planes` are a, b and c.
pub(super) struct Plane<'a> {
    pub(super) planes: [&'a [Panel]; 3],
    pub(super) x: &'a [Panel],
    pub(super) y: &'a [Panel],
    pub(super) out: &'a mut [Panel],
}

impl Kernel for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { planes: [a, b, c], x, y, out } = self;
        let panels_len = a.len();
        assert!(x.len() == out.len() && y.len() == out.len());
        assert!(b.len() == panels_len && c.len() == panels_len);
        let rows = x.chunks_exact(panels_len).zip(y.chunks_exact(panels_len));
        for ((x, y), out) in rows.zip(out.chunks_exact_mut(panels_len)) {
            for panel in 0..panels_len {
                for i in 0..PANEL {
                    out[panel][i] = a[panel][i] * y[panel][i] + b[panel][i] * x[panel][i] + c[panel][i];
                }
            }
        }
    }
}
