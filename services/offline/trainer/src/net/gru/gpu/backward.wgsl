// The way back over the horizon: ROWS rows a workgroup, a thread for each component of their states.

// W_h and the head: [389, 128].
@group(0) @binding(1) var<storage, read> weight: array<f32>;
// r ‖ z ‖ n ‖ Hₙ: [horizon, rows, 512].
@group(0) @binding(2) var<storage, read> gates: array<f32>;
// States before each step and after the last: [horizon + 1, rows, 128].
@group(0) @binding(3) var<storage, read> states: array<f32>;
// By what the head put out: [rows, horizon × 5].
@group(0) @binding(4) var<storage, read> d_raw: array<f32>;
// By H, the head's output and Iₙ, beside the state that was read: [horizon + 1, rows, 517].
@group(0) @binding(5) var<storage, read_write> d: array<f32>;
// By the state before the first step: [rows, 128].
@group(0) @binding(6) var<storage, read_write> d_hidden: array<f32>;

// Gradients by H, then by the head's output, of these rows.
var<workgroup> d_row: array<f32, ROWS * STACKED>;

@compute @workgroup_size(HIDDEN)
fn backward(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) j: u32) {
    let first = group.x * ROWS;
    var d_state: array<f32, ROWS>;
    for (var at = size.horizon + 1u; at > 0u; at--) {
        // The state number `at − 1` was read by the step of the same number and by the head of the one before.
        let step = at - 1u;
        for (var i = 0u; i < ROWS; i++) {
            let row = first + i;
            let inside = row < size.rows;
            var d_r = 0.0;
            var d_z = 0.0;
            var d_n = 0.0;
            var d_by_state = 0.0;
            if inside && step < size.horizon {
                let kept = (step * size.rows + row) * 4u * HIDDEN + j;
                let r = gates[kept];
                let z = gates[kept + HIDDEN];
                let n = gates[kept + 2u * HIDDEN];
                let by_state = gates[kept + 3u * HIDDEN];
                let h = states[(step * size.rows + row) * HIDDEN + j];
                let d_through = d_state[i] * z;
                d_n = (d_state[i] - d_through) * (1.0 - n * n);
                d_z = d_through * (1.0 - z) * (h - n);
                d_by_state = d_n * r;
                d_r = d_by_state * (1.0 - r) * by_state;
                d_state[i] = d_through;
            }
            d_row[i * STACKED + j] = d_r;
            d_row[i * STACKED + HIDDEN + j] = d_z;
            d_row[i * STACKED + 2u * HIDDEN + j] = d_by_state;
            if inside {
                let out = (step * size.rows + row) * COLUMNS + j;
                d[out] = d_r;
                d[out + HIDDEN] = d_z;
                d[out + 2u * HIDDEN] = d_by_state;
                d[out + STACKED] = d_n;
            }
            if j < CONTROL {
                var d_control = 0.0;
                if inside && step > 0u {
                    d_control = d_raw[(row * size.horizon + step - 1u) * CONTROL + j];
                }
                d_row[i * STACKED + GATES + j] = d_control;
                if inside {
                    d[(step * size.rows + row) * COLUMNS + GATES + j] = d_control;
                }
            }
        }
        workgroupBarrier();
        for (var o = 0u; o < STACKED; o++) {
            let w = weight[o * HIDDEN + j];
            for (var i = 0u; i < ROWS; i++) {
                d_state[i] += w * d_row[i * STACKED + o];
            }
        }
        workgroupBarrier();
    }
    for (var i = 0u; i < ROWS; i++) {
        if first + i < size.rows {
            d_hidden[(first + i) * HIDDEN + j] = d_state[i];
        }
    }
}
