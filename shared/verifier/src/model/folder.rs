use std::path::{Path, PathBuf};

use nn::{ModelConfig, Weights, WeightsError};
use safetensors::{Dtype, SafeTensors};
use scene::{AgentType, State};
use serde::Deserialize;

use crate::VerifyError;

/// The contents of `scene.json`; other keys are ignored.
#[derive(Deserialize)]
pub(super) struct Scene {
    types: Vec<String>,
    /// The agents that drive a bicycle.
    pub(super) vehicles: Vec<usize>,
    pub(super) rear_axle_m: f32,
    pub(super) accel_limit_mps2: f32,
    pub(super) slip_rate_limit_radps: f32,
    pub(super) map_origin_m: [f32; 2],
    /// Rows, columns.
    pub(super) map_shape: [usize; 2],
    position_m: Vec<Vec<[f32; 2]>>,
    velocity_mps: Vec<Vec<[f32; 2]>>,
    heading_rad: Vec<Vec<f32>>,
    present: Vec<Vec<bool>>,
}

/// A golden folder, read and checked.
pub(super) struct Folder {
    path: PathBuf,
    pub(super) scene: Scene,
    pub(super) types: Vec<AgentType>,
    pub(super) weights: Weights,
    tensors: Vec<u8>,
}

impl Folder {
    pub(super) fn open(path: &Path) -> Result<Self, VerifyError> {
        let read = |name: &str| {
            let path = path.join(name);
            std::fs::read(&path).map_err(|source| VerifyError::unreadable(&path, source))
        };
        let scene: Scene = serde_json::from_slice(&read("scene.json")?)
            .map_err(|e| VerifyError::caused(&path.join("scene.json"), "", e))?;
        let types = scene
            .types
            .iter()
            .map(|name| {
                name.parse::<AgentType>().map_err(|e| VerifyError::caused(&path.join("scene.json"), "", e))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let weights = Weights::from_bytes(&read("weights.safetensors")?).map_err(|source| {
            VerifyError::Weights { path: path.join("weights.safetensors").display().to_string(), source }
        })?;
        let tensors = read("tensors.safetensors")?;
        SafeTensors::deserialize(&tensors)
            .map_err(|e| VerifyError::caused(&path.join("tensors.safetensors"), "", e))?;
        let folder = Self { path: path.to_owned(), scene, types, weights, tensors };
        folder.check_sizes().map_err(|reason| VerifyError::malformed(&path.join("scene.json"), reason))?;
        Ok(folder)
    }

    fn check_sizes(&self) -> Result<(), String> {
        let (agents_len, step_count) =
            (self.types.len(), self.config().history_len + self.config().horizon_len);
        let rows = [
            ("position_m", self.scene.position_m.iter().map(Vec::len).collect::<Vec<_>>()),
            ("velocity_mps", self.scene.velocity_mps.iter().map(Vec::len).collect()),
            ("heading_rad", self.scene.heading_rad.iter().map(Vec::len).collect()),
            ("present", self.scene.present.iter().map(Vec::len).collect()),
        ];
        for (name, lens) in rows {
            if lens.len() != step_count || lens.iter().any(|len| *len != agents_len) {
                return Err(format!("{name} is not {step_count} steps of {agents_len} agents"));
            }
        }
        match self.scene.vehicles.iter().find(|agent| **agent >= agents_len) {
            Some(agent) => Err(format!("vehicles names agent {agent} of {agents_len}")),
            None if agents_len == 0 => Err("there are no agents".to_owned()),
            None => Ok(()),
        }
    }

    pub(super) fn config(&self) -> &ModelConfig {
        self.weights.config()
    }

    /// An agent's state at a step, if the agent is present. Steps count through history and horizon.
    pub(super) fn state(&self, step: usize, agent: usize) -> Option<State> {
        self.scene.present[step][agent].then(|| State {
            position_m: self.scene.position_m[step][agent],
            velocity_mps: self.scene.velocity_mps[step][agent],
            heading_rad: self.scene.heading_rad[step][agent],
        })
    }

    pub(super) fn tensor_names(&self) -> impl Iterator<Item = String> {
        let names = SafeTensors::deserialize(&self.tensors)
            .map(|t| t.names().into_iter().map(str::to_owned).collect());
        names.unwrap_or_else(|_| Vec::new()).into_iter()
    }

    /// Shape and numbers of a tensor.
    pub(super) fn tensor(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), VerifyError> {
        let wrong = |reason: String| self.malformed(format!("{name}: {reason}"));
        let refused = |error| VerifyError::caused(&self.path.join("tensors.safetensors"), name, error);
        let tensors = SafeTensors::deserialize(&self.tensors).map_err(refused)?;
        let view = tensors.tensor(name).map_err(refused)?;
        if view.dtype() != Dtype::F32 {
            return Err(wrong(format!("is {:?}, expected F32", view.dtype())));
        }
        let numbers = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        Ok((view.shape().to_vec(), numbers.collect()))
    }

    /// The rows of a tensor, \[…, N\].
    pub(super) fn rows<const N: usize>(&self, name: &str) -> Result<Vec<[f32; N]>, VerifyError> {
        let (shape, numbers) = self.tensor(name)?;
        if shape.last() != Some(&N) {
            return Err(self.malformed(format!("{name} has shape {shape:?}, expected rows of {N}")));
        }
        Ok(numbers.as_chunks().0.to_vec())
    }

    pub(super) fn malformed(&self, reason: String) -> VerifyError {
        VerifyError::malformed(&self.path.join("tensors.safetensors"), reason)
    }

    pub(super) fn weights_error(&self, source: WeightsError) -> VerifyError {
        VerifyError::Weights { path: self.path.join("weights.safetensors").display().to_string(), source }
    }
}
