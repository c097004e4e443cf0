//! Tensors as safetensors files.

use std::collections::HashMap;

use half::f16;
use nn::Stored;
use safetensors::{Dtype, SafeTensors};

use super::layout::Entry;
use super::tensors::Tensors;
use crate::error::TensorError;

fn decode(dtype: Dtype, bytes: &[u8]) -> Option<Vec<f32>> {
    match dtype {
        Dtype::F32 => Some(bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect()),
        Dtype::F16 => {
            Some(bytes.as_chunks::<2>().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect())
        }
        _ => None,
    }
}

impl Tensors {
    /// All tensors as the bytes of a safetensors file.
    pub(crate) fn to_safetensors(
        &self,
        stored: Stored,
        metadata: HashMap<String, String>,
    ) -> Result<Vec<u8>, TensorError> {
        let tensors = self
            .0
            .iter()
            .map(|(name, tensor)| (name.as_str(), tensor.shape.as_slice(), tensor.values.as_slice()));
        Ok(nn::encode(tensors, stored, metadata)?)
    }

    /// The tensors of `layout` from the bytes of a safetensors file; other tensors in the file are ignored.
    pub(crate) fn from_safetensors(bytes: &[u8], layout: &[Entry]) -> Result<Self, TensorError> {
        let file = SafeTensors::deserialize(bytes)?;
        let mut tensors = Self::default();
        for entry in layout {
            let view = file.tensor(&entry.name)?;
            if view.shape() != entry.shape {
                return Err(TensorError::Shape {
                    name: entry.name.clone(),
                    expected: entry.shape.clone(),
                    found: view.shape().to_vec(),
                });
            }
            let values = decode(view.dtype(), view.data())
                .ok_or_else(|| TensorError::ElementType { name: entry.name.clone(), found: view.dtype() })?;
            tensors.insert(&entry.name, &entry.shape, values, entry.role);
        }
        Ok(tensors)
    }
}
