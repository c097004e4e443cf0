//! The operands of a product in bf16.

use half::bf16;

use crate::buffer::Buffer;
use crate::kernels::product::PANEL;

/// Maximum number of inputs of a layer.
pub(crate) const IN_MAX: usize = 128;

/// The content of a proof: empty, or a type that can't exist if no processor has the dot products.
#[cfg(target_arch = "x86_64")]
pub(super) type Proof = ();
#[cfg(not(target_arch = "x86_64"))]
pub(super) type Proof = std::convert::Infallible;

/// Proof that the processor has bf16 dot products.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DotProducts(pub(super) Proof);

/// A bf16 matrix in the kernel's reading order, with an f32 bias.
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code, reason = "there are no dot products to read them"))]
pub(crate) struct PairPanels {
    pub(super) proof: DotProducts,
    /// Pairs, each in the bits of one f32: the even input in the lower half.
    pub(super) values: Buffer,
    pub(super) bias: Buffer,
    pub(super) in_len: usize,
    pub(super) panel_count: usize,
}

/// A product's input and output; see [`bf16`](super).
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code, reason = "as above"))]
pub(crate) struct PairProduct<'a> {
    /// Rows at a distance of `stride` floats.
    pub(crate) input: &'a [f32],
    pub(crate) stride: usize,
    /// The matrix, with the bias.
    pub(crate) panels: &'a PairPanels,
    /// Added before the ReLU; in the layout of `out`.
    pub(crate) residual: Option<&'a [f32]>,
    /// Whether negative results become 0.
    pub(crate) relu: bool,
    /// \[row, `panels.out_stride()`\].
    pub(crate) out: &'a mut [f32],
}

impl PairPanels {
    /// Rounds and packs the matrix whose entry (out, in) is `weight(out, in)`. Outputs are padded with zeros
    /// to whole panels.
    pub(crate) fn pack(
        proof: DotProducts,
        [out_len, in_len]: [usize; 2],
        weight: impl Fn(usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        assert!((1..=IN_MAX).contains(&in_len) && out_len > 0, "a {in_len} × {out_len} matrix");
        let panel_count = out_len.div_ceil(PANEL);
        let pair_count = in_len.div_ceil(2);
        let mut values = Buffer::zeroed(panel_count * pair_count * PANEL);
        let mut padded_bias = Buffer::zeroed(panel_count * PANEL);
        for out in 0..out_len {
            padded_bias[out] = bias(out);
            let bits = |i: usize| if i < in_len { bf16::from_f32(weight(out, i)).to_bits() } else { 0 };
            for pair in 0..pair_count {
                let [low, high] = [2 * pair, 2 * pair + 1].map(|i| u32::from(bits(i)));
                let place = (out / PANEL * pair_count + pair) * PANEL + out % PANEL;
                values[place] = f32::from_bits(high << 16 | low);
            }
        }
        Self { proof, values, bias: padded_bias, in_len, panel_count }
    }

    /// Length of an output row: a multiple of 16.
    pub(crate) const fn out_stride(&self) -> usize {
        self.panel_count * PANEL
    }

    #[cfg(target_arch = "x86_64")]
    pub(super) const fn pair_count(&self) -> usize {
        self.in_len.div_ceil(2)
    }
}
