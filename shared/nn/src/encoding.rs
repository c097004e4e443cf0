use wire::{LATENT, TEMPORAL};

use crate::linear::{Mlp, MlpMemory};
use crate::weights::{Weights, WeightsError};

/// The encoding function for training: the posterior mean of the latent variable, 128 → 128 → 128 → 32.
pub struct EncodingFunction {
    mlp: Mlp,
}

impl EncodingFunction {
    /// The layers `encoder.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        Ok(Self { mlp: Mlp::read(weights, "encoder", &[2 * TEMPORAL, 128, 128, LATENT])? })
    }

    /// Posterior means m of temporal summaries \[ṽ_h ‖ ṽ_f\], one per row.
    pub fn means(
        &self,
        summaries: &[[f32; 2 * TEMPORAL]],
        memory: &mut MlpMemory,
        out: &mut [[f32; LATENT]],
    ) {
        self.mlp.run(summaries.as_flattened(), memory, out.as_flattened_mut());
    }
}
