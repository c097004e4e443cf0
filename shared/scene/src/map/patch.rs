use wire::PATCH_CHANNELS;

use crate::State;

/// Numbers per cell in the interpolation: the three channels, and a spare one that fills the vector register.
pub(super) const CHANNEL_LANES: usize = 4;

/// Size of local patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatchOptions {
    /// Cells along each side, P.
    pub side: usize,
    /// Side of a patch's cell.
    pub cell_m: f32,
    /// Distance of a patch's centre ahead of the agent, in the direction of its future.
    pub ahead_m: f32,
}

impl PatchOptions {
    /// Length of a patch: three channels of P × P.
    pub const fn len(&self) -> usize {
        PATCH_CHANNELS * self.side * self.side
    }

    /// Whether a patch has no cells.
    pub const fn is_empty(&self) -> bool {
        self.side == 0
    }
}

/// A grid of 1 m cells from which patches are cut.
pub(super) trait Cells {
    /// Lower left corner of cell (0, 0) in the world frame.
    fn origin_m(&self) -> [f32; 2];
    /// Rows and columns.
    fn size(&self) -> [usize; 2];
    /// \[ln(1 + B/B̄), VF x, VF y, anything\] of a cell within the size.
    fn cell(&self, row: usize, col: usize) -> [f32; CHANNEL_LANES];
}

/// Cuts the patch of an agent at `state`.
///
/// ```text
/// row r, column c  ←  p + R(ψ) (((P−1)/2 − r) · cell + ahead, ((P−1)/2 − c) · cell)       [model §2]
/// ```
///
/// Row 0 is farthest ahead, and column 0 is leftmost. Values are bilinear between cell centres. Velocities
/// are in the agent's axes.
pub(super) fn sample(map: &impl Cells, state: &State, options: PatchOptions, out: &mut [f32]) {
    assert_eq!(out.len(), options.len(), "room for one patch");
    let area = options.side * options.side;
    let (density, velocity) = out.split_at_mut(area);
    let (velocity_x, velocity_y) = velocity.split_at_mut(area);
    let (sin, cos) = state.heading_rad.sin_cos();
    let half = (options.side as f32 - 1.0) * 0.5;
    let origin_m = map.origin_m();
    // In units of cells from the centre of cell (0, 0). Integer and fraction are separate, so fractions far
    // from the origin are as exact as near it.
    let [(whole_x, centre_x), (whole_y, centre_y)] = [0, 1].map(|axis| {
        let (position, origin) = (floor(state.position_m[axis]), floor(origin_m[axis]));
        let fraction = (state.position_m[axis] - position as f32) - (origin_m[axis] - origin as f32);
        (position.wrapping_sub(origin), fraction - 0.5)
    });
    let mut cell = 0;
    for row in 0..options.side {
        let ahead_m = (half - row as f32) * options.cell_m + options.ahead_m;
        let (row_x, row_y) = (centre_x + cos * ahead_m, centre_y + sin * ahead_m);
        for col in 0..options.side {
            let left_m = (half - col as f32) * options.cell_m;
            let [relative, vx, vy, _] =
                interpolate(map, [whole_x, whole_y], row_x - sin * left_m, row_y + cos * left_m);
            density[cell] = relative;
            velocity_x[cell] = cos * vx + sin * vy;
            velocity_y[cell] = cos * vy - sin * vx;
            cell += 1;
        }
    }
}

/// The cells around the point at (x, y) from the centre of cell `whole` (column, row), weighted bilinearly.
#[inline]
fn interpolate(map: &impl Cells, whole: [i32; 2], x: f32, y: f32) -> [f32; CHANNEL_LANES] {
    let (left, low) = (floor(x), floor(y));
    let (right, up) = (x - left as f32, y - low as f32);
    let (col, row) = (whole[0].wrapping_add(left), whole[1].wrapping_add(low));
    let corners = [
        (row, col, (1.0 - right) * (1.0 - up)),
        (row, col.wrapping_add(1), right * (1.0 - up)),
        (row.wrapping_add(1), col, (1.0 - right) * up),
        (row.wrapping_add(1), col.wrapping_add(1), right * up),
    ];
    let [rows, cols] = map.size();
    let mut sum = [0.0; CHANNEL_LANES];
    for (row, col, weight) in corners {
        // A negative index becomes larger than any size.
        let (row, col) = (row as u32 as usize, col as u32 as usize);
        if row < rows && col < cols {
            let corner = map.cell(row, col);
            for (sum, value) in sum.iter_mut().zip(corner) {
                *sum += weight * value;
            }
        }
    }
    sum
}

/// The largest integer at or below `value`. `f32::floor` calls the C library on the oldest x86-64 machines.
#[inline]
fn floor(value: f32) -> i32 {
    let truncated = value as i32;
    truncated - i32::from(truncated as f32 > value)
}
