//! Batch norm, with the residual and the ReLU after it.
//!
//! ```text
//! y = γ (x − mean) / √(var + ε) + β
//! ```
//!
//! If mean and variance come from the batch, they depend on its N rows:
//!
//! ```text
//! dx = γ / √(var + ε) · (dy − Σ dy / N − (x − mean) / (var + ε) · Σ dy (x − mean) / N)
//! ```

mod rows;
#[cfg(test)]
mod tests;

use nn::kernels::dispatch;
use nn::kernels::product::PANEL;

use super::map::Map;
use crate::net::tensors::{Gradients, Tensors};
use rows::{Line, Panel, Plane, Slopes, Spread, Sums, Total};

/// The source of the batch norms' mean and variance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Normalisation {
    /// From the batch; the running values are updated.
    Batch,
    /// From the running values, as the onboard network does.
    Running,
}

/// PyTorch's addition to the variance.
const EPSILON: f64 = 1e-5;
/// Weight of a new batch in the running mean and variance.
const MOMENTUM: f32 = 0.1;

/// A forward pass through the network.
pub(super) struct Pass<'a> {
    pub(super) weights: &'a Tensors,
    pub(super) normalisation: Normalisation,
    /// New running values of the batch norms: (tensor name, values).
    pub(super) statistics: Vec<(String, Vec<f32>)>,
}

/// A backward pass through the network.
pub(super) struct BackwardPass<'a> {
    pub(super) weights: &'a Tensors,
    pub(super) gradients: &'a mut Gradients,
}

/// A batch norm with the tensors `name.weight`, `.bias`, `.running_mean` and `.running_var`.
pub(super) struct Norm(pub(super) String);

/// The operations after a batch norm.
#[derive(Clone, Copy)]
pub(super) enum Then<'a> {
    Nothing,
    Relu,
    /// The sum with a shortcut, then the ReLU.
    AddRelu(&'a Map),
}

/// The values that the backward pass of a batch norm needs.
pub(super) struct NormTrace {
    x: Map,
    moments: ChannelMoments,
    normalisation: Normalisation,
}

/// Mean and variance of each channel.
struct ChannelMoments {
    mean: Vec<Panel>,
    variance: Vec<Panel>,
}

impl Norm {
    /// Normalises `x`.
    pub(super) fn forward(&self, pass: &mut Pass<'_>, x: Map, then: Then<'_>) -> (Map, NormTrace) {
        let moments = match pass.normalisation {
            Normalisation::Running => self.running(pass.weights),
            Normalisation::Batch => {
                let moments = ChannelMoments::of(&x);
                self.move_running(pass, &moments, x.rows());
                moments
            }
        };
        let mut scale = self.gamma(pass.weights);
        let mut shift = padded(self.tensor(pass.weights, "bias"));
        for (panel, scale) in scale.iter_mut().enumerate() {
            for c in 0..PANEL {
                let factor = f64::from(scale[c]) * moments.inverse(panel, c);
                scale[c] = factor as f32;
                shift[panel][c] -= (factor * f64::from(moments.mean[panel][c])) as f32;
            }
        }
        let (z, floor) = match then {
            Then::Nothing => (None, f32::NEG_INFINITY),
            Then::Relu => (None, 0.0),
            Then::AddRelu(shortcut) => (Some(shortcut.panels()), 0.0),
        };
        let mut y = x.like();
        dispatch(Line { line: [&scale, &shift], x: x.panels(), z, floor, out: y.panels_mut() });
        (y, NormTrace { x, moments, normalisation: pass.normalisation })
    }

    /// The backward pass: gradient by the input.
    ///
    /// `dy` is the gradient by the output `rectified` of the ReLU, if there is one. It becomes the gradient
    /// before the ReLU, which is also the gradient by the shortcut.
    pub(super) fn backward(
        &self,
        pass: &mut BackwardPass<'_>,
        trace: &NormTrace,
        rectified: Option<&Map>,
        dy: &mut Map,
    ) -> Map {
        let NormTrace { x, moments, normalisation } = trace;
        let rectified = rectified.map(Map::panels);
        let sums = dispatch(Slopes { x: x.panels(), mean: &moments.mean, rectified, dy: dy.panels_mut() });
        let share = match normalisation {
            Normalisation::Batch => 1.0 / x.rows() as f64,
            Normalisation::Running => 0.0,
        };
        let mut by_dy = self.gamma(pass.weights);
        let mut by_x = vec![[0.0; PANEL]; sums.len()];
        let mut constant = by_x.clone();
        for (panel, [sum, product]) in sums.iter().enumerate() {
            for c in 0..PANEL {
                let inverse = moments.inverse(panel, c);
                let factor = f64::from(by_dy[panel][c]) * inverse;
                let slope = -factor * inverse * inverse * product[c] * share;
                by_dy[panel][c] = factor as f32;
                by_x[panel][c] = slope as f32;
                constant[panel][c] =
                    (-factor * sum[c] * share - slope * f64::from(moments.mean[panel][c])) as f32;
            }
        }
        self.add_gradients(pass.gradients, moments, &sums);
        let mut dx = x.like();
        let plane = [by_dy.as_slice(), &by_x, &constant];
        dispatch(Plane { plane, x: dy.panels(), y: x.panels(), out: dx.panels_mut() });
        dx
    }

    /// Adds the gradients by γ and β, given Σ dy and Σ dy (x − mean).
    fn add_gradients(&self, gradients: &mut Gradients, moments: &ChannelMoments, sums: &[[Sums; 2]]) {
        for (c, d_beta) in gradients.get_mut(&self.part("bias")).iter_mut().enumerate() {
            *d_beta += sums[c / PANEL][0][c % PANEL] as f32;
        }
        for (c, d_gamma) in gradients.get_mut(&self.part("weight")).iter_mut().enumerate() {
            let (panel, c) = (c / PANEL, c % PANEL);
            *d_gamma += (sums[panel][1][c] * moments.inverse(panel, c)) as f32;
        }
    }

    /// Moves the running moments towards the moments of a batch with `row_count` rows.
    fn move_running(&self, pass: &mut Pass<'_>, batch: &ChannelMoments, row_count: usize) {
        let unbiased = (row_count as f64 / (row_count as f64 - 1.0).max(1.0)) as f32;
        for (part, new, factor) in
            [("running_mean", &batch.mean, 1.0), ("running_var", &batch.variance, unbiased)]
        {
            let pairs = self.tensor(pass.weights, part).iter().zip(new.as_flattened());
            let moved = pairs.map(|(old, new)| old * (1.0 - MOMENTUM) + new * factor * MOMENTUM);
            pass.statistics.push((self.part(part), moved.collect()));
        }
    }

    fn running(&self, weights: &Tensors) -> ChannelMoments {
        let moment = |part: &str| padded(self.tensor(weights, part));
        ChannelMoments { mean: moment("running_mean"), variance: moment("running_var") }
    }

    fn gamma(&self, weights: &Tensors) -> Vec<Panel> {
        padded(self.tensor(weights, "weight"))
    }

    fn tensor<'a>(&self, weights: &'a Tensors, part: &str) -> &'a [f32] {
        weights.get(&self.part(part))
    }

    fn part(&self, part: &str) -> String {
        format!("{}.{part}", self.0)
    }
}

impl ChannelMoments {
    /// The moments of a map's rows.
    fn of(x: &Map) -> Self {
        assert!(x.rows() > 0, "moments of no rows");
        let share = 1.0 / x.rows() as f64;
        let means = |sums: Vec<[Sums; 1]>| -> Vec<Panel> {
            sums.iter().map(|[sums]| sums.map(|sum| (sum * share) as f32)).collect()
        };
        let panel_count = x.channels / PANEL;
        let mean = means(dispatch(Total { x: x.panels(), panel_count }));
        let variance = means(dispatch(Spread { x: x.panels(), mean: &mean }));
        Self { mean, variance }
    }

    /// 1 / √(var + ε).
    fn inverse(&self, panel: usize, c: usize) -> f64 {
        (f64::from(self.variance[panel][c]) + EPSILON).sqrt().recip()
    }
}

/// Channels in whole panels, filled up with zeros.
fn padded(channels: &[f32]) -> Vec<Panel> {
    let mut panels = vec![[0.0; PANEL]; channels.len().div_ceil(PANEL)];
    panels.as_flattened_mut()[..channels.len()].copy_from_slice(channels);
    panels
}
