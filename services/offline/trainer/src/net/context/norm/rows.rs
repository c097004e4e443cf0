//! The passes of a batch norm over the rows \[row, panel\] of a map.

use std::ops::Range;

use nn::kernels::product::PANEL;
use nn::kernels::{Kernel, Lanes};

/// Sixteen channels of a row.
pub(super) type Panel = [f32; PANEL];
/// Sums of sixteen channels over all rows.
pub(super) type Sums = [f64; PANEL];

/// Number of rows that are summed in single precision.
const ROWS: usize = 256;

/// Sums over rows that are processed block by block, K for each panel of channels.
struct Totals<const K: usize>(Vec<[Sums; K]>);

impl<const K: usize> Totals<K> {
    fn zeros(panel_count: usize) -> Self {
        Self(vec![[[0.0; PANEL]; K]; panel_count])
    }

    /// The places \[row, panel\] of each block.
    fn blocks(&self, place_count: usize) -> impl Iterator<Item = Range<usize>> + use<K> {
        let block_len = ROWS * self.0.len();
        (0..place_count).step_by(block_len).map(move |start| start..place_count.min(start + block_len))
    }

    /// Adds the `terms` of (panel, place, channels from … on) of a block.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, l: L, block: Range<usize>, terms: impl Fn(usize, usize, usize) -> [L::V; K]) {
        let panel_count = self.0.len();
        for (panel, totals) in self.0.iter_mut().enumerate() {
            for c in (0..PANEL).step_by(L::LEN) {
                let mut sums = [l.splat(0.0); K];
                for place in (block.start + panel..block.end).step_by(panel_count) {
                    for (sum, term) in sums.iter_mut().zip(terms(panel, place, c)) {
                        *sum = l.add(*sum, term);
                    }
                }
                for (total, sum) in totals.iter_mut().zip(sums) {
                    let mut lanes = [0.0; PANEL];
                    l.store(&mut lanes, sum);
                    for (total, sum) in total[c..].iter_mut().zip(&lanes[..L::LEN]) {
                        *total += f64::from(*sum);
                    }
                }
            }
        }
    }
}

/// Σ x.
pub(super) struct Total<'a> {
    pub(super) x: &'a [Panel],
    pub(super) panel_count: usize,
}

impl Kernel for Total<'_> {
    type Output = Vec<[Sums; 1]>;

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> Self::Output {
        let mut totals = Totals::zeros(self.panel_count);
        for block in totals.blocks(self.x.len()) {
            totals.add(l, block, |_, place, c| [l.load(&self.x[place][c..])]);
        }
        totals.0
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
    fn run<L: Lanes>(self, l: L) -> Self::Output {
        let mut totals = Totals::zeros(self.mean.len());
        for block in totals.blocks(self.x.len()) {
            totals.add(l, block, |panel, place, c| {
                let off = l.sub(l.load(&self.x[place][c..]), l.load(&self.mean[panel][c..]));
                [l.mul(off, off)]
            });
        }
        totals.0
    }
}

/// Σ dy and Σ dy (x − mean). First sets `dy` to zero at the zeros of `rectified`.
pub(super) struct Slopes<'a> {
    pub(super) x: &'a [Panel],
    pub(super) mean: &'a [Panel],
    pub(super) rectified: Option<&'a [Panel]>,
    pub(super) dy: &'a mut [Panel],
}

impl Kernel for Slopes<'_> {
    type Output = Vec<[Sums; 2]>;

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> Self::Output {
        let Self { x, mean, rectified, dy } = self;
        assert!(dy.len() == x.len() && rectified.is_none_or(|y| y.len() == x.len()), "maps of one shape");
        let mut totals = Totals::zeros(mean.len());
        for block in totals.blocks(x.len()) {
            if let Some(y) = rectified {
                let dy = dy[block.clone()].as_flattened_mut();
                for (dy, y) in dy.iter_mut().zip(y[block.clone()].as_flattened()) {
                    *dy = if *y > 0.0 { *dy } else { 0.0 };
                }
            }
            totals.add(l, block, |panel, place, c| {
                let dy = l.load(&dy[place][c..]);
                let off = l.sub(l.load(&x[place][c..]), l.load(&mean[panel][c..]));
                [dy, l.mul(dy, off)]
            });
        }
        totals.0
    }
}

/// out = a x + b + z, at least `floor`; `line` is a and b.
pub(super) struct Line<'a> {
    pub(super) line: [&'a [Panel]; 2],
    pub(super) x: &'a [Panel],
    pub(super) z: Option<&'a [Panel]>,
    pub(super) floor: f32,
    pub(super) out: &'a mut [Panel],
}

impl Kernel for Line<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self { line: [a, b], x, z, floor, out } = self;
        assert!(z.is_none_or(|z| z.len() == x.len()), "maps of one shape");
        let floor = l.splat(floor);
        for (row, out) in out.chunks_exact_mut(a.len()).enumerate() {
            for (panel, out) in out.iter_mut().enumerate() {
                let place = row * a.len() + panel;
                for c in (0..PANEL).step_by(L::LEN) {
                    let at = |panel: &Panel| l.load(&panel[c..]);
                    let mut y = l.fma(at(&a[panel]), at(&x[place]), at(&b[panel]));
                    if let Some(z) = z {
                        y = l.add(y, at(&z[place]));
                    }
                    l.store(&mut out[c..], l.max(y, floor));
                }
            }
        }
    }
}

/// out = a x + b y + c; `plane` is a, b and c.
pub(super) struct Plane<'a> {
    pub(super) plane: [&'a [Panel]; 3],
    pub(super) x: &'a [Panel],
    pub(super) y: &'a [Panel],
    pub(super) out: &'a mut [Panel],
}

impl Kernel for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self { plane: [a, b, c], x, y, out } = self;
        for (row, out) in out.chunks_exact_mut(a.len()).enumerate() {
            for (panel, out) in out.iter_mut().enumerate() {
                let place = row * a.len() + panel;
                for i in (0..PANEL).step_by(L::LEN) {
                    let at = |panel: &Panel| l.load(&panel[i..]);
                    let line = l.fma(at(&b[panel]), at(&y[place]), at(&c[panel]));
                    l.store(&mut out[i..], l.fma(at(&a[panel]), at(&x[place]), line));
                }
            }
        }
    }
}
