//! The element-wise half of the gated recurrent unit.

use super::math::{sigmoid, tanh};
use super::{Kernel, Lanes, dispatch};

/// Length of the decoder's hidden state.
pub(crate) const HIDDEN: usize = 128;
/// Length of the three gates (r, z, n) before activation.
pub(crate) const GATES: usize = 3 * HIDDEN;

/// One step of a gated recurrent unit on a batch of hidden states:
///
/// ```text
/// r = σ(i_r + h_r)   z = σ(i_z + h_z)   n = tanh(i_n + r h_n)   h' = (1 − z) n + z h
/// ```
///
/// `input` is W_i x + b_i and `hidden` W_h h + b_h, each \[row, r ‖ z ‖ n\]; an `input` of one row serves all
/// rows. Leaves other numbers in `hidden`.
pub(crate) fn gru_step(input: &[f32], hidden: &mut [f32], state: &mut [f32]) {
    dispatch(Gru { input, hidden, state });
}

struct Gru<'a> {
    input: &'a [f32],
    hidden: &'a mut [f32],
    state: &'a mut [f32],
}

impl Kernel for Gru<'_> {
    type Output = ();

    /// Each row in two passes: r and n in one go are a chain too long for a processor to see the next one
    /// behind it.
    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let stride = if self.input.len() == GATES { 0 } else { GATES };
        let rows = self.state.chunks_exact_mut(HIDDEN).zip(self.hidden.chunks_exact_mut(GATES));
        for (row, (state, hidden)) in rows.enumerate() {
            let input = &self.input[row * stride..][..GATES];
            for i in (0..HIDDEN).step_by(L::LEN) {
                let r = sigmoid(l, l.add(gate(l, input, 0, i), gate(l, hidden, 0, i)));
                let n = l.fma(r, gate(l, hidden, 2, i), gate(l, input, 2, i));
                l.store(&mut hidden[2 * HIDDEN + i..], n);
            }
            for i in (0..HIDDEN).step_by(L::LEN) {
                let z = sigmoid(l, l.add(gate(l, input, 1, i), gate(l, hidden, 1, i)));
                l.store(&mut hidden[HIDDEN + i..], z);
            }
            for i in (0..HIDDEN).step_by(L::LEN) {
                let (z, n) = (gate(l, hidden, 1, i), tanh(l, gate(l, hidden, 2, i)));
                let h = l.load(&state[i..]);
                l.store(&mut state[i..], l.fma(z, l.sub(h, n), n));
            }
        }
    }
}

/// The values from `i` on of one of the three gates of a row.
#[inline(always)]
fn gate<L: Lanes>(l: L, row: &[f32], gate: usize, i: usize) -> L::V {
    l.load(&row[gate * HIDDEN + i..])
}
