//! Tensors as safetensors files.

use std::collections::HashMap;

use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::layout::Entry;
use super::tensors::Tensors;
use crate::error::TensorError;

/// How values are stored in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Precision {
    /// Half precision: weights that are shipped.
    F16,
    /// Single precision: checkpoints.
    F32,
}

impl Precision {
    fn dtype(self) -> Dtype {
        match self {
            Self::F16 => Dtype::F16,
            Self::F32 => Dtype::F32,
        }
    }

    fn encode(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::F16 => values.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()).collect(),
            Self::F32 => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        }
    }
}

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
        precision: Precision,
        metadata: HashMap<String, String>,
    ) -> Result<Vec<u8>, TensorError> {
        let encoded: Vec<(&str, &[usize], Vec<u8>)> = self
            .0
            .iter()
            .map(|(name, tensor)| (name.as_str(), tensor.shape.as_slice(), precision.encode(&tensor.values)))
            .collect();
        let views = encoded
            .iter()
            .map(|(name, shape, bytes)| {
                Ok((*name, TensorView::new(precision.dtype(), shape.to_vec(), bytes)?))
            })
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
        Ok(safetensors::serialize(views, Some(metadata.into_iter().collect()))?)
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
