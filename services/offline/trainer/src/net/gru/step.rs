//! The element-wise half of a recurrent step, forward and backward.

use nn::kernels::{Kernel, Lanes, sigmoid, tanh};

/// Length of the hidden state.
pub(super) const HIDDEN: usize = 128;
/// Length of the three gates.
pub(super) const GATES: usize = 3 * HIDDEN;
/// Floats per row and step that the forward pass keeps for the backward pass: r ‖ z ‖ n ‖ Hₙ ‖ h.
pub(super) const KEPT: usize = 5 * HIDDEN;
/// Offset of h in these floats.
pub(super) const KEPT_STATE: usize = 4 * HIDDEN;
/// Length of the column sums of the backward pass: first the sums of I, then those of Hₙ.
pub(super) const SUMS: usize = 4 * HIDDEN;

/// One step of a batch of hidden states, in place:
///
/// ```text
/// r = σ(Iᵣ + Hᵣ)   z = σ(I_z + H_z)   n = tanh(Iₙ + r Hₙ)   h' = n + z (h − n)
/// ```
pub(super) struct Step<'a> {
    /// I = W_i x + b_i, `[rows, 384]`, or a single row for all.
    pub(super) input: &'a [f32],
    /// H = W_h h + b_h in the first columns, `[rows, …]`.
    pub(super) recurrent: &'a [f32],
    /// h, then h', `[rows, 128]`.
    pub(super) state: &'a mut [f32],
    /// 0 if the row keeps its state, `[rows]`; `None` if all rows change.
    pub(super) present: Option<&'a [f32]>,
    /// Output: `[rows, KEPT]` for the backward pass.
    pub(super) kept: Option<&'a mut Vec<f32>>,
}

impl Kernel for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, l: L) {
        let row_count = self.state.len() / HIDDEN;
        let input_stride = if self.input.len() == GATES { 0 } else { GATES };
        let stride = self.recurrent.len() / row_count.max(1);
        let mut kept = [0.0; KEPT];
        for (row, state) in self.state.as_chunks_mut::<HIDDEN>().0.iter_mut().enumerate() {
            if self.present.is_some_and(|present| present[row] == 0.0) {
                if let Some(all) = &mut self.kept {
                    all.extend_from_slice(&idle(state));
                }
                continue;
            }
            let input = gates(&self.input[row * input_stride..]);
            let recurrent = gates(&self.recurrent[row * stride..]);
            for i in (0..HIDDEN).step_by(L::LEN) {
                let at = |from: &[f32; GATES], gate: usize| l.load(&from[gate * HIDDEN + i..]);
                let r = sigmoid(l, l.add(at(input, 0), at(recurrent, 0)));
                let z = sigmoid(l, l.add(at(input, 1), at(recurrent, 1)));
                let by_state = at(recurrent, 2);
                let n = tanh(l, l.fma(r, by_state, at(input, 2)));
                let h = l.load(&state[i..]);
                l.store(&mut state[i..], l.fma(z, l.sub(h, n), n));
                if self.kept.is_some() {
                    for (part, value) in [r, z, n, by_state, h].into_iter().enumerate() {
                        l.store(&mut kept[part * HIDDEN + i..], value);
                    }
                }
            }
            if let Some(all) = &mut self.kept {
                all.extend_from_slice(&kept);
            }
        }
    }
}

/// The trace of a row that keeps its state. z = 1 passes the gradient through and leaves none for the gates.
fn idle(state: &[f32; HIDDEN]) -> [f32; KEPT] {
    let mut kept = [0.0; KEPT];
    kept[HIDDEN..2 * HIDDEN].fill(1.0);
    kept[KEPT_STATE..].copy_from_slice(state);
    kept
}

/// The backward pass of [`Step`].
pub(super) struct StepBackward<'a> {
    /// The trace of the step, `[rows, KEPT]`.
    pub(super) kept: &'a [f32],
    /// Gradient by h'. It becomes the part of the gradient by h that does not pass through H, `[rows, 128]`.
    pub(super) d_state: &'a mut [f32],
    /// Output: the gradient by H in the first columns, `[rows, …]`.
    pub(super) d_recurrent: &'a mut [f32],
    /// Output: the gradient by I, `[rows, 384]`.
    pub(super) d_input: Option<&'a mut [f32]>,
    /// The column sums of the gradients by I and by Hₙ are added to these sums.
    pub(super) sums: &'a mut [f32; SUMS],
}

impl Kernel for StepBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, l: L) {
        let row_count = self.d_state.len() / HIDDEN;
        let stride = self.d_recurrent.len() / row_count.max(1);
        let one = l.splat(1.0);
        let rows = self.kept.as_chunks::<KEPT>().0.iter().zip(self.d_state.as_chunks_mut::<HIDDEN>().0);
        for (row, (kept, d_state)) in rows.enumerate() {
            let d_recurrent = gates_mut(&mut self.d_recurrent[row * stride..]);
            let mut d_input = self.d_input.as_mut().map(|d| gates_mut(&mut d[row * GATES..]));
            for i in (0..HIDDEN).step_by(L::LEN) {
                let part = |part: usize| l.load(&kept[part * HIDDEN + i..]);
                let (r, z, n, by_state, h) = (part(0), part(1), part(2), part(3), part(4));
                let d = l.load(&d_state[i..]);
                let d_through = l.mul(d, z);
                // (1 − z) d, n' = 1 − n²
                let d_n = l.mul(l.sub(d, d_through), l.sub(one, l.mul(n, n)));
                // σ' = σ (1 − σ)
                let d_z = l.mul(l.mul(d_through, l.sub(one, z)), l.sub(h, n));
                let d_by_state = l.mul(d_n, r);
                let d_r = l.mul(l.mul(d_by_state, l.sub(one, r)), by_state);
                l.store(&mut d_state[i..], d_through);
                for (gate, value) in [d_r, d_z, d_by_state].into_iter().enumerate() {
                    l.store(&mut d_recurrent[gate * HIDDEN + i..], value);
                }
                if let Some(d_input) = &mut d_input {
                    for (gate, value) in [d_r, d_z, d_n].into_iter().enumerate() {
                        l.store(&mut d_input[gate * HIDDEN + i..], value);
                    }
                }
                for (part, value) in [d_r, d_z, d_n, d_by_state].into_iter().enumerate() {
                    let sum = &mut self.sums[part * HIDDEN + i..];
                    let more = l.add(l.load(sum), value);
                    l.store(sum, more);
                }
            }
        }
    }
}

/// The gates at the beginning of a row.
#[inline(always)]
fn gates(row: &[f32]) -> &[f32; GATES] {
    row.first_chunk().expect("a row holds its gates")
}

#[inline(always)]
fn gates_mut(row: &mut [f32]) -> &mut [f32; GATES] {
    row.first_chunk_mut().expect("a row holds its gates")
}
