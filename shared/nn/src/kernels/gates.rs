//! The element-wise half of the gated recurrent unit.

use super::math::Exponential;
use super::{Kernel, Lanes, dispatch};

/// Length of the decoder's hidden state.
pub(crate) const HIDDEN: usize = 128;
/// Length of the three gates (r, z, n) before activation.
pub(crate) const GATES: usize = 3 * HIDDEN;
/// e^−x, the exponential of a sigmoid. Both exponentials are clamped at arguments for which sigmoid and
/// tangent are within 1e-17 of their limits. The product of two of them is finite.
const SIGMOID: Exponential = Exponential { factor: -1.0, range: [-40.0, 40.0] };
/// e^2x, the exponential of a hyperbolic tangent.
const TANGENT: Exponential = Exponential { factor: 2.0, range: [-20.0, 20.0] };

/// One step of a gated recurrent unit on a batch of hidden states:
///
/// ```text
/// r = σ(i_r + h_r)   z = σ(i_z + h_z)   n = tanh(i_n + r h_n)   h' = (1 − z) n + z h
/// ```
///
/// `input` is W_i x + b_i and `hidden` W_h h + b_h, each \[row, r ‖ z ‖ n\]. An `input` of one row is used
/// for all rows. Overwrites `hidden`.
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

    /// Each row is processed in four passes. No pass contains a dependency chain as long as a whole sigmoid:
    /// a processor can't overlap enough of these chains to fill its units. Intermediate results are in
    /// `hidden` and on the stack. With e_z = e^−x of the gate z and e_n = e^2x of n, h' is one quotient:
    ///
    /// ```text
    /// z = 1 / (1 + e_z)   n = (e_n − 1) / (e_n + 1)
    /// h' = (e_z (e_n − 1) + (e_n + 1) h) / ((1 + e_z) (e_n + 1))
    /// ```
    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let stride = if self.input.len() == GATES { 0 } else { GATES };
        let (mut rest, mut power) = ([[0.0; HIDDEN]; 2], [[0.0; HIDDEN]; 2]);
        let one = l.splat(1.0);
        let rows = self.state.chunks_exact_mut(HIDDEN).zip(self.hidden.chunks_exact_mut(GATES));
        for (row, (state, hidden)) in rows.enumerate() {
            let input = &self.input[row * stride..][..GATES];
            for i in (0..HIDDEN).step_by(L::LEN) {
                for of in 0..2 {
                    let x = l.add(gate(l, input, of, i), gate(l, hidden, of, i));
                    let (r, n) = SIGMOID.reduce(l, x);
                    l.store(&mut rest[of][i..], r);
                    l.store(&mut power[of][i..], n);
                }
            }
            for i in (0..HIDDEN).step_by(L::LEN) {
                let e_r = SIGMOID.raise(l, l.load(&rest[0][i..]), l.load(&power[0][i..]));
                let e_z = SIGMOID.raise(l, l.load(&rest[1][i..]), l.load(&power[1][i..]));
                l.store(&mut hidden[HIDDEN + i..], e_z);
                l.store(&mut hidden[i..], l.div(one, l.add(one, e_r)));
            }
            for i in (0..HIDDEN).step_by(L::LEN) {
                let x = l.fma(gate(l, hidden, 0, i), gate(l, hidden, 2, i), gate(l, input, 2, i));
                let (r, n) = TANGENT.reduce(l, x);
                l.store(&mut rest[0][i..], r);
                l.store(&mut power[0][i..], n);
            }
            for i in (0..HIDDEN).step_by(L::LEN) {
                let e_n = TANGENT.raise(l, l.load(&rest[0][i..]), l.load(&power[0][i..]));
                let e_z = gate(l, hidden, 1, i);
                let (less, more) = (l.sub(e_n, one), l.add(e_n, one));
                let h = l.fma(e_z, less, l.mul(more, l.load(&state[i..])));
                l.store(&mut state[i..], l.div(h, l.mul(l.add(one, e_z), more)));
            }
        }
    }
}

/// The values from index `i` of one of the three gates of a row.
#[inline(always)]
fn gate<L: Lanes>(l: L, row: &[f32], gate: usize, i: usize) -> L::V {
    l.load(&row[gate * HIDDEN + i..])
}
