// The gradient by a matrix, dyᵀ x, with the column sums of dy behind it: TILE × TILE results a workgroup.

struct Size {
    // Rows of dy and x.
    rows: u32,
    // Columns of dy and of x.
    outs: u32,
    ins: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> size: Size;
@group(0) @binding(1) var<storage, read> dy: array<f32>;
@group(0) @binding(2) var<storage, read> x: array<f32>;
// [outs, ins + 1]: the last column is the sum.
@group(0) @binding(3) var<storage, read_write> sum: array<f32>;

var<workgroup> dy_tile: array<f32, TILE * TILE>;
var<workgroup> x_tile: array<f32, TILE * TILE>;

@compute @workgroup_size(TILE, TILE)
fn sum_of_products(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_id) at: vec3<u32>,
) {
    let column = group.x * TILE + at.x;
    let out = group.y * TILE + at.y;
    var total = 0.0;
    for (var first = 0u; first < size.rows; first += TILE) {
        let row = first + at.y;
        let inside = row < size.rows;
        // The tiles are read along their rows; dy's lies turned.
        let dy_column = group.y * TILE + at.x;
        dy_tile[at.x * TILE + at.y] = select(0.0, dy[min(row, size.rows - 1u) * size.outs + min(dy_column, size.outs - 1u)], inside && dy_column < size.outs);
        let one = select(0.0, 1.0, column == size.ins);
        x_tile[at.y * TILE + at.x] = select(0.0, select(one, x[min(row, size.rows - 1u) * size.ins + min(column, size.ins - 1u)], column < size.ins), inside);
        workgroupBarrier();
        for (var k = 0u; k < TILE; k++) {
            total += dy_tile[at.y * TILE + k] * x_tile[k * TILE + at.x];
        }
        workgroupBarrier();
    }
    if out < size.outs && column <= size.ins {
        sum[out * (size.ins + 1u) + column] = total;
    }
}
