// The recurrent unit over the horizon: ROWS rows a workgroup, a thread for each component of their states.
//
//     r = σ(Iᵣ + Hᵣ)   z = σ(I_z + H_z)   n = tanh(Iₙ + r Hₙ)   h' = n + z (h − n)   raw = W_o h' + b_o

// W_h and the head, transposed: [128, 389].
@group(0) @binding(1) var<storage, read> weight: array<f32>;
// Biases of W_h and the head, then that of W_i: [389 + 384].
@group(0) @binding(2) var<storage, read> bias: array<f32>;
// I of the first step: [rows, 384].
@group(0) @binding(3) var<storage, read> input: array<f32>;
// States before the first step: [agents, 128].
@group(0) @binding(4) var<storage, read> hidden: array<f32>;
// What the head puts out: [rows, horizon × 5].
@group(0) @binding(5) var<storage, read_write> raw: array<f32>;
// r ‖ z ‖ n ‖ Hₙ: [horizon, rows, 512].
@group(0) @binding(6) var<storage, read_write> gates: array<f32>;
// States before each step and after the last: [horizon + 1, rows, 128].
@group(0) @binding(7) var<storage, read_write> states: array<f32>;

var<workgroup> state: array<f32, ROWS * HIDDEN>;

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-x));
}

// tanh overflows on some devices where exp does.
fn squashed(x: f32) -> f32 {
    return 2.0 * sigmoid(2.0 * x) - 1.0;
}

@compute @workgroup_size(HIDDEN)
fn forward(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) j: u32) {
    let first = group.x * ROWS;
    for (var i = 0u; i < ROWS; i++) {
        let row = min(first + i, size.rows - 1u);
        state[i * HIDDEN + j] = hidden[row / size.draws * HIDDEN + j];
        if size.keep != 0u && first + i < size.rows {
            states[row * HIDDEN + j] = state[i * HIDDEN + j];
        }
    }
    workgroupBarrier();
    for (var step = 0u; step < size.horizon; step++) {
        var h_r: array<f32, ROWS>;
        var h_z: array<f32, ROWS>;
        var h_n: array<f32, ROWS>;
        for (var i = 0u; i < ROWS; i++) {
            h_r[i] = bias[j];
            h_z[i] = bias[HIDDEN + j];
            h_n[i] = bias[2u * HIDDEN + j];
        }
        for (var k = 0u; k < HIDDEN; k++) {
            let w = k * STACKED + j;
            let w_r = weight[w];
            let w_z = weight[w + HIDDEN];
            let w_n = weight[w + 2u * HIDDEN];
            for (var i = 0u; i < ROWS; i++) {
                let h = state[i * HIDDEN + k];
                h_r[i] += w_r * h;
                h_z[i] += w_z * h;
                h_n[i] += w_n * h;
            }
        }
        workgroupBarrier();
        for (var i = 0u; i < ROWS; i++) {
            let row = first + i;
            var i_r = bias[STACKED + j];
            var i_z = bias[STACKED + HIDDEN + j];
            var i_n = bias[STACKED + 2u * HIDDEN + j];
            if step == 0u {
                let at = min(row, size.rows - 1u) * GATES + j;
                i_r = input[at];
                i_z = input[at + HIDDEN];
                i_n = input[at + 2u * HIDDEN];
            }
            let r = sigmoid(i_r + h_r[i]);
            let z = sigmoid(i_z + h_z[i]);
            let n = squashed(i_n + r * h_n[i]);
            let h = n + z * (state[i * HIDDEN + j] - n);
            state[i * HIDDEN + j] = h;
            if size.keep != 0u && row < size.rows {
                let at = (step * size.rows + row) * 4u * HIDDEN + j;
                gates[at] = r;
                gates[at + HIDDEN] = z;
                gates[at + 2u * HIDDEN] = n;
                gates[at + 3u * HIDDEN] = h_n[i];
                states[((step + 1u) * size.rows + row) * HIDDEN + j] = h;
            }
        }
        workgroupBarrier();
        let i = j / CONTROL;
        let row = first + i;
        if i < ROWS && row < size.rows {
            let control = j % CONTROL;
            var sum = bias[GATES + control];
            for (var k = 0u; k < HIDDEN; k++) {
                sum += weight[k * STACKED + GATES + control] * state[i * HIDDEN + k];
            }
            raw[(row * size.horizon + step) * CONTROL + control] = sum;
        }
    }
}
