//! The model's weights, kept under the names that the safetensors file gives them.
//!
//! A parameter is stored flat on the plain (not differentiating) device, beside its shape. [`Parameters::leaves`]
//! hands out the tensors of one training step, which record gradients; [`Parameters::frozen`] hands out the same
//! tensors without, for what needs no gradient. Both forms are a [`Weights`], so the model is written once.

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::TrainError;

/// What training does to a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Follows its gradient.
    Learned,
    /// Running mean or variance of a batch norm.
    Statistic,
    /// Fitted before training (base control) and fixed since.
    Fixed,
}

/// One named tensor.
#[derive(Clone, Debug)]
pub(crate) struct Parameter {
    pub(crate) shape: Vec<usize>,
    pub(crate) value: Tensor<1>,
    pub(crate) role: Role,
}

/// All weights of a model, by name.
#[derive(Clone, Debug, Default)]
pub struct Parameters {
    pub(crate) tensors: BTreeMap<String, Parameter>,
}

/// The weights as one forward pass sees them.
#[derive(Clone, Debug)]
pub struct Weights {
    tensors: BTreeMap<String, (Vec<usize>, Tensor<1>)>,
}

impl Weights {
    /// The tensor called `name`.
    ///
    /// # Panics
    ///
    /// Panics where the model has no such tensor or its rank is not `D`: [`crate::model::layout`] lists the names.
    #[must_use]
    pub fn get<const D: usize>(&self, name: &str) -> Tensor<D> {
        let (shape, value) =
            self.tensors.get(name).unwrap_or_else(|| panic!("the model has no tensor `{name}`"));
        let shape: [usize; D] =
            shape.as_slice().try_into().unwrap_or_else(|_| panic!("`{name}` has another rank"));
        value.clone().reshape(shape)
    }

    /// Flat tensor called `name`, the leaf that gradients belong to.
    pub(crate) fn leaf(&self, name: &str) -> Option<&Tensor<1>> {
        self.tensors.get(name).map(|(_, value)| value)
    }
}

impl Parameters {
    /// Adds or replaces a tensor.
    ///
    /// # Panics
    ///
    /// Panics where `values` does not fill `shape`.
    pub fn insert(&mut self, name: &str, shape: &[usize], values: Vec<f32>, role: Role, device: &Device) {
        assert_eq!(values.len(), shape.iter().product::<usize>(), "`{name}` does not fill {shape:?}");
        let value = Tensor::from_data(TensorData::new(values, [shape.iter().product::<usize>()]), device);
        self.tensors.insert(name.to_owned(), Parameter { shape: shape.to_vec(), value, role });
    }

    /// Replaces the values of tensors that are there.
    pub(crate) fn replace(&mut self, values: Vec<(String, Tensor<1>)>) {
        for (name, value) in values {
            if let Some(parameter) = self.tensors.get_mut(&name) {
                parameter.value = value;
            }
        }
    }

    /// The weights for a forward pass that is differentiated.
    #[must_use]
    pub fn leaves(&self) -> Weights {
        self.weights(|parameter| match parameter.role {
            Role::Learned => parameter.value.clone().autodiff().require_grad(),
            Role::Statistic | Role::Fixed => parameter.value.clone(),
        })
    }

    /// The weights for a forward pass without gradients.
    #[must_use]
    pub fn frozen(&self) -> Weights {
        self.weights(|parameter| parameter.value.clone())
    }

    fn weights(&self, value: impl Fn(&Parameter) -> Tensor<1>) -> Weights {
        let tensors = self
            .tensors
            .iter()
            .map(|(name, parameter)| (name.clone(), (parameter.shape.clone(), value(parameter))));
        Weights { tensors: tensors.collect() }
    }

    /// The values of `name`, row-major; `None` where there is no such tensor.
    #[must_use]
    pub fn values(&self, name: &str) -> Option<Vec<f32>> {
        self.tensors.get(name).map(|parameter| host(parameter.value.clone()))
    }

    /// Number of values in all tensors.
    #[must_use]
    pub fn values_len(&self) -> usize {
        self.tensors.values().map(|parameter| parameter.shape.iter().product::<usize>()).sum()
    }

    /// Writes all tensors as the bytes of a safetensors file.
    ///
    /// # Errors
    ///
    /// Returns [`TrainError::Safetensors`] where the file cannot be laid out.
    pub fn to_safetensors(
        &self,
        precision: Precision,
        metadata: std::collections::HashMap<String, String>,
    ) -> Result<Vec<u8>, TrainError> {
        let bytes: Vec<(&str, &[usize], Vec<u8>)> = self
            .tensors
            .iter()
            .map(|(name, parameter)| {
                (name.as_str(), parameter.shape.as_slice(), precision.encode(&host(parameter.value.clone())))
            })
            .collect();
        let views = bytes
            .iter()
            .map(|(name, shape, bytes)| {
                Ok((*name, TensorView::new(precision.dtype(), shape.to_vec(), bytes)?))
            })
            .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
        Ok(safetensors::serialize(views, Some(metadata))?)
    }

    /// Reads the tensors that `layout` lists from the bytes of a safetensors file; others in the file are left alone.
    ///
    /// # Errors
    ///
    /// Returns an error where the file is malformed, a tensor is missing, or its shape or type is another.
    pub fn from_safetensors(
        bytes: &[u8],
        layout: &[crate::model::Entry],
        device: &Device,
    ) -> Result<Self, TrainError> {
        let file = SafeTensors::deserialize(bytes)?;
        let mut parameters = Self::default();
        for entry in layout {
            let view = file.tensor(&entry.name)?;
            if view.shape() != entry.shape {
                return Err(TrainError::Shape {
                    name: entry.name.clone(),
                    expected: entry.shape.clone(),
                    found: view.shape().to_vec(),
                });
            }
            let values = decode(view.dtype(), view.data()).ok_or_else(|| TrainError::ElementType {
                name: entry.name.clone(),
                found: format!("{:?}", view.dtype()),
            })?;
            parameters.insert(&entry.name, &entry.shape, values, entry.role, device);
        }
        Ok(parameters)
    }
}

/// How values are stored in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
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
        Dtype::F32 => {
            Some(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        }
        Dtype::F16 => {
            Some(bytes.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect())
        }
        _ => None,
    }
}

/// Copies a tensor to the host.
///
/// # Panics
///
/// Panics where the device fails to hand out f32 values: all tensors of the trainer are f32.
pub(crate) fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.inner().into_data().try_into_vec::<f32>().expect("the trainer's tensors are f32")
}
