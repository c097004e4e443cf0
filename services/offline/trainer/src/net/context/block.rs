//! A residual block: two convolutions with their batch norms, and a shortcut around them.

use super::convolution::{Convolution, Geometry};
use super::map::Map;
use super::norm::{BackwardPass, Norm, NormTrace, Pass, Then};

/// A convolution and its batch norm.
struct Unit {
    convolution: Convolution,
    norm: Norm,
}

impl Unit {
    fn new(name: &str, parts: [&str; 2], geometry: Geometry, channels: [usize; 2]) -> Self {
        let [convolution, norm] = parts.map(|part| format!("{name}.{part}"));
        Self {
            convolution: Convolution::new(format!("{convolution}.weight"), geometry, channels),
            norm: Norm(norm),
        }
    }

    fn forward(&self, pass: &mut Pass<'_>, x: &Map, then: Then<'_>) -> (Map, NormTrace) {
        let convolved = self.convolution.forward(pass.weights, x);
        self.norm.forward(pass, convolved, then)
    }

    /// Gradient by the input `x`, added to `sum` if there is one. `rectified` and `dy` are as in the norm.
    fn backward(
        &self,
        pass: &mut BackwardPass<'_>,
        trace: &NormTrace,
        x: &Map,
        (rectified, dy): (Option<&Map>, &mut Map),
        sum: Option<&Map>,
    ) -> Map {
        let d_convolved = self.norm.backward(pass, trace, rectified, dy);
        self.convolution.by_kernel(pass.gradients, x, &d_convolved);
        self.convolution.by_input(pass.weights, &d_convolved, sum)
    }
}

/// y = ReLU(norm(conv(ReLU(norm(conv x)))) + shortcut x).
pub(super) struct Block {
    first: Unit,
    second: Unit,
    /// The shortcut; `None` if it is the identity.
    projection: Option<Unit>,
    out_side: usize,
}

/// The values that the backward pass of a block needs besides its input and output.
pub(super) struct BlockTrace {
    first: NormTrace,
    inner: Map,
    second: NormTrace,
    projection: Option<NormTrace>,
}

impl Block {
    /// The block with the tensors `name.…` on a map with `side` rows; `stride` 2 halves them.
    pub(super) fn new(name: &str, side: usize, stride: usize, channels: [usize; 2]) -> Self {
        let geometry = Geometry { side, kernel: 3, stride, padding: 1 };
        let out_side = geometry.out_side();
        let inner = Geometry { side: out_side, kernel: 3, stride: 1, padding: 1 };
        let around = Geometry { side, kernel: 1, stride, padding: 0 };
        Self {
            first: Unit::new(name, ["conv1", "bn1"], geometry, channels),
            second: Unit::new(name, ["conv2", "bn2"], inner, [channels[1]; 2]),
            projection: (stride != 1)
                .then(|| Unit::new(name, ["downsample.0", "downsample.1"], around, channels)),
            out_side,
        }
    }

    pub(super) const fn out_side(&self) -> usize {
        self.out_side
    }

    pub(super) fn forward(&self, pass: &mut Pass<'_>, x: &Map) -> (Map, BlockTrace) {
        let (inner, first) = self.first.forward(pass, x, Then::Relu);
        let around = self.projection.as_ref().map(|unit| unit.forward(pass, x, Then::Nothing));
        let (projected, projection) = around.unzip();
        let shortcut = projected.as_ref().unwrap_or(x);
        let (y, second) = self.second.forward(pass, &inner, Then::AddRelu(shortcut));
        (y, BlockTrace { first, inner, second, projection })
    }

    /// Gradient by the input `x`, from the gradient `dy` by the output `y`.
    pub(super) fn backward(
        &self,
        pass: &mut BackwardPass<'_>,
        trace: &BlockTrace,
        [x, y]: [&Map; 2],
        mut dy: Map,
    ) -> Map {
        let BlockTrace { first, inner, second, projection } = trace;
        let mut d_inner = self.second.backward(pass, second, inner, (Some(y), &mut dy), None);
        // `dy` is now the gradient by the shortcut.
        if let Some((unit, trace)) = self.projection.as_ref().zip(projection.as_ref()) {
            dy = unit.backward(pass, trace, x, (None, &mut dy), None);
        }
        self.first.backward(pass, first, x, (Some(inner), &mut d_inner), Some(&dy))
    }
}
