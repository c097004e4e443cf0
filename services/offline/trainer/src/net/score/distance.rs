//! Distances between trajectories.

use super::super::matrix::Matrix;
use crate::kernel::kernel;

/// Keeps the square root differentiable at distance zero.
const ROOT_EPSILON_M2: f32 = 1e-6;

/// Distances `[rows, horizon]` between the positions of `a` and `b`. Row r of `a` belongs to row r /
/// `draw_count` of `b`.
pub(super) fn distances(a: &Matrix, b: &Matrix, draw_count: usize) -> Matrix {
    assert_shapes(a, b, draw_count);
    let mut distances = Matrix::zeros(a.rows, a.cols / 2);
    measure(a, b, draw_count, &mut distances);
    distances
}

/// Gradient by `a`, given the `slopes` by its [`distances`] to `b`. The gradient by `b` is the negative of
/// it.
pub(super) fn distances_backward(a: &Matrix, b: &Matrix, draw_count: usize, slopes: &Matrix) -> Matrix {
    assert_shapes(a, b, draw_count);
    assert_eq!((a.rows, a.cols), (slopes.rows, slopes.cols * 2), "a slope for every position");
    let mut gradient = Matrix::zeros(a.rows, a.cols);
    differentiate(a, b, draw_count, slopes, &mut gradient);
    gradient
}

fn assert_shapes(a: &Matrix, b: &Matrix, draw_count: usize) {
    assert_eq!((a.rows, a.cols), (b.rows * draw_count, b.cols), "shapes of trajectories");
}

kernel! {
    fn measure<'a>(a: &'a Matrix, b: &'a Matrix, draw_count: usize, distances: &'a mut Matrix) {
        for row in 0..a.rows {
            let (a, b) = (a.row(row).as_chunks().0, b.row(row / draw_count).as_chunks().0);
            for ((distance, a), b) in distances.row_mut(row).iter_mut().zip(a).zip(b) {
                *distance = between(*a, *b).1;
            }
        }
    }
}

kernel! {
    fn differentiate<'a>(
        a: &'a Matrix,
        b: &'a Matrix,
        draw_count: usize,
        slopes: &'a Matrix,
        gradient: &'a mut Matrix,
    ) {
        for row in 0..a.rows {
            let (a, b) = (a.row(row).as_chunks().0, b.row(row / draw_count).as_chunks().0);
            let gradient = gradient.row_mut(row).as_chunks_mut().0.iter_mut();
            for (((gradient, a), b), slope) in gradient.zip(a).zip(b).zip(slopes.row(row)) {
                let (difference, distance) = between(*a, *b);
                let factor = slope / distance;
                *gradient = [difference[0] * factor, difference[1] * factor];
            }
        }
    }
}

/// a − b, and its length.
#[inline(always)]
fn between(a: [f32; 2], b: [f32; 2]) -> ([f32; 2], f32) {
    let [x, y] = [a[0] - b[0], a[1] - b[1]];
    ([x, y], (x * x + y * y + ROOT_EPSILON_M2).sqrt())
}
