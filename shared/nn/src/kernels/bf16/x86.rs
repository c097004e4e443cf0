#![expect(unsafe_code, reason = "AVX-512 BF16 intrinsics, and a register tile that reads through pointers")]

use std::arch::x86_64::*;
use std::mem::transmute;

use super::pairs::{IN_MAX, PairProduct};
use crate::kernels::product::PANEL;

/// Rows that are rounded together: they stay in the first-level cache while all panels are processed.
const ROWS: usize = 48;
/// Distance between rounded rows, in pairs.
const PAIRS: usize = IN_MAX / 2;
/// Floats that are rounded together.
const TOGETHER: usize = 16;

type Rounded = [[i32; PAIRS]; ROWS];

/// Computes a product whose slice lengths were checked.
pub(super) fn run(product: PairProduct<'_>, row_count: usize) {
    // SAFETY: the panels hold a proof that the processor has AVX-512 BF16, and slices and rows were checked.
    unsafe { blocks(product, row_count) }
}

/// # Safety
/// The processor has the features; input and output hold `row_count` rows.
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn blocks(mut product: PairProduct<'_>, row_count: usize) {
    let mut rounded = [[0; PAIRS]; ROWS];
    let mut first = 0;
    while first < row_count {
        let len = ROWS.min(row_count - first);
        // SAFETY: the rows lie within the input.
        unsafe { round(&product, first, &mut rounded[..len]) };
        let panel_count = product.panels.panel_count;
        let mut panel = 0;
        while panel + 2 <= panel_count {
            // SAFETY: `len` rows were rounded, and panels and output contain the addressed places.
            unsafe { rows::<2>(&mut product, &rounded, panel, first, len) };
            panel += 2;
        }
        if panel < panel_count {
            // SAFETY: as above.
            unsafe { rows::<1>(&mut product, &rounded, panel, first, len) };
        }
        first += len;
    }
}

/// Rounds rows of the input into `rounded`, from row `first`, until `rounded` is full.
///
/// # Safety
/// The input holds the rows.
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn round(product: &PairProduct<'_>, first: usize, rounded: &mut [[i32; PAIRS]]) {
    let in_len = product.panels.in_len;
    for (row, rounded) in rounded.iter_mut().enumerate() {
        let from = product.input.as_ptr().wrapping_add((first + row) * product.stride);
        for c in (0..in_len).step_by(TOGETHER) {
            let mask = if in_len - c >= TOGETHER { !0 } else { (1 << (in_len - c)) - 1 };
            // SAFETY: the mask keeps the load within the row; a rounded row has room for all inputs in steps
            // of `TOGETHER`, which divides `IN_MAX`.
            unsafe {
                let values = _mm512_maskz_loadu_ps(mask, from.wrapping_add(c));
                let pairs: __m256i = transmute(_mm512_cvtneps_pbh(values));
                _mm256_storeu_si256(rounded.as_mut_ptr().wrapping_add(c / 2).cast(), pairs);
            }
        }
    }
}

/// All rounded rows of V panels, in tiles of at most 12 rows.
///
/// # Safety
/// `len` rows were rounded; panels, residual and output hold the columns and rows addressed.
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn rows<const V: usize>(
    product: &mut PairProduct<'_>,
    rounded: &Rounded,
    panel: usize,
    first: usize,
    len: usize,
) {
    // SAFETY: the caller vouches for what the tiles address.
    unsafe {
        let mut row = 0;
        row = tiles::<12, V>(product, rounded, panel, first, row, len);
        row = tiles::<8, V>(product, rounded, panel, first, row, len);
        row = tiles::<4, V>(product, rounded, panel, first, row, len);
        row = tiles::<2, V>(product, rounded, panel, first, row, len);
        tiles::<1, V>(product, rounded, panel, first, row, len);
    }
}

/// All whole tiles of R rows from `row`; returns the first remaining row.
///
/// # Safety
/// As of [`rows`].
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn tiles<const R: usize, const V: usize>(
    product: &mut PairProduct<'_>,
    rounded: &Rounded,
    panel: usize,
    first: usize,
    mut row: usize,
    len: usize,
) -> usize {
    let pair_count = product.panels.pair_count();
    let values = product.panels.values.as_ptr().cast::<i32>();
    let mut weights = [values; V];
    for (v, weights) in weights.iter_mut().enumerate() {
        *weights = values.wrapping_add((panel + v) * pair_count * PANEL);
    }
    while row + R <= len {
        let mut from = [rounded[row].as_ptr(); R];
        for (r, from) in from.iter_mut().enumerate() {
            *from = rounded[row + r].as_ptr();
        }
        // SAFETY: rows and panels hold `pair_count` pairs, of each column in a panel.
        let sums = unsafe { chain(from, weights, pair_count) };
        // SAFETY: the caller vouches for the places of the tile.
        unsafe { write(product, panel, first + row, &sums) };
        row += R;
    }
    row
}

/// sum + a · b, for the two numbers in each of 16 pairs.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
fn dot(sum: __m512, a: __m512i, b: __m512i) -> __m512 {
    // SAFETY: a vector of 16 pairs is one of 32 numbers, whatever their bits.
    let [a, b]: [__m512bh; 2] = unsafe { transmute::<[__m512i; 2], [__m512bh; 2]>([a, b]) };
    _mm512_dpbf16_ps(sum, a, b)
}

/// The sums of a tile: `len` dot products each, in order.
///
/// This separate function takes the sums by value, so that each sum stays in its register. The test of the
/// emitted code checks this.
///
/// # Safety
/// Each of the rows is valid for reading `len` pairs, each of the weights for `len` vectors.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn chain<const R: usize, const V: usize>(
    rows: [*const i32; R],
    weights: [*const i32; V],
    len: usize,
) -> [[__m512; V]; R] {
    let mut sums = [[_mm512_setzero_ps(); V]; R];
    for pair in 0..len {
        let mut w = [_mm512_setzero_si512(); V];
        for (w, weights) in w.iter_mut().zip(weights) {
            // SAFETY: the caller vouches for them.
            *w = unsafe { _mm512_loadu_si512(weights.wrapping_add(pair * PANEL).cast()) };
        }
        for (row, sums) in rows.iter().zip(&mut sums) {
            // SAFETY: the caller vouches for the rows.
            let x = _mm512_set1_epi32(unsafe { *row.wrapping_add(pair) });
            for (sum, w) in sums.iter_mut().zip(&w) {
                *sum = dot(*sum, x, *w);
            }
        }
    }
    sums
}

/// Adds bias and residual to the sums of a tile and writes them.
///
/// # Safety
/// Bias, residual and output hold the columns of the panels and the rows from `row` on.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
unsafe fn write<const R: usize, const V: usize>(
    product: &mut PairProduct<'_>,
    panel: usize,
    row: usize,
    sums: &[[__m512; V]; R],
) {
    let stride = product.panels.out_stride();
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            let column = (panel + v) * PANEL;
            let place = (row + r) * stride + column;
            // SAFETY: within the bias, which has a value for each column.
            let bias = unsafe { _mm512_loadu_ps(product.panels.bias.as_ptr().wrapping_add(column)) };
            let mut y = _mm512_add_ps(*sum, bias);
            if let Some(residual) = product.residual {
                // SAFETY: the residual has the output's length.
                y = _mm512_add_ps(y, unsafe { _mm512_loadu_ps(residual.as_ptr().wrapping_add(place)) });
            }
            if product.relu {
                y = _mm512_max_ps(y, _mm512_setzero_ps());
            }
            // SAFETY: within the output.
            unsafe { _mm512_storeu_ps(product.out.as_mut_ptr().wrapping_add(place), y) };
        }
    }
}
