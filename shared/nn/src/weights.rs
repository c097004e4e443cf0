//! Weights files: safetensors with the model's configuration in their metadata.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use half::f16;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::{ConfigError, ContextCnn, Decoder, Gdat, ModelConfig, RelationMlp, StateMlp};

const ONBOARD: &[u8] = if cfg!(feature = "free-weights") {
    include_bytes!("../weights/onboard-free.safetensors")
} else {
    include_bytes!("../weights/onboard.safetensors")
};
/// Bytes that hold the length of a safetensors header.
const LENGTH_BYTES: usize = 8;

/// Why weights can't be used.
#[derive(Debug, Error)]
pub enum WeightsError {
    /// The file can't be read.
    #[error("{path}: {source}")]
    Unreadable {
        /// The file.
        path: String,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// The file is shorter than its header indicates.
    #[error("weights are truncated: {found} bytes of {expected}")]
    Truncated {
        /// Actual size in bytes.
        found: usize,
        /// Size in bytes according to the header.
        expected: usize,
    },
    /// The file has another format.
    #[error("not a safetensors file: {0}")]
    NotSafetensors(#[from] SafeTensorError),
    /// The metadata hold no configuration.
    #[error("model configuration in the weights: the metadata key \"config\" is missing")]
    NoConfig,
    /// The configuration is not valid JSON, or belongs to another version.
    #[error("model configuration in the weights: {0}")]
    Config(#[source] serde_json::Error),
    /// The model card is not valid JSON.
    #[error("model card in the weights: {0}")]
    Card(#[source] serde_json::Error),
    /// A value of the configuration is impossible.
    #[error("model configuration in the weights: {0}")]
    ConfigValue(#[from] ConfigError),
    /// The weights belong to another model than the run's.
    #[error("the weights are of another model than the run's: {key} is {found}, not {expected}")]
    OtherModel {
        /// The first key of the configuration that differs.
        key: String,
        /// Value in the weights; null if they do not have it.
        found: serde_json::Value,
        /// Value in the run's model.
        expected: serde_json::Value,
    },
    /// A tensor that the model needs is missing.
    #[error("tensor {name} is missing")]
    Missing {
        /// The tensor.
        name: String,
    },
    /// A tensor has another shape than the model needs.
    #[error("tensor {name} has shape {found:?}, the model needs {expected:?}")]
    Shape {
        /// The tensor.
        name: String,
        /// Shape.
        found: Vec<usize>,
        /// The model's shape.
        expected: Vec<usize>,
    },
    /// A tensor has another number type than f32 or f16.
    #[error("tensor {name} holds {dtype:?}, expected F32 or F16")]
    Type {
        /// The tensor.
        name: String,
        /// The type of its values.
        dtype: Dtype,
    },
    /// A tensor holds an infinite value or NaN.
    #[error("tensor {name}: value {index} is {value}")]
    NotFinite {
        /// The tensor.
        name: String,
        /// Place in row-major order.
        index: usize,
        /// The value.
        value: f32,
    },
}

/// How the values of a file are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    /// Half precision: weights that are shipped.
    F16,
    /// Single precision: checkpoints.
    F32,
}

/// The bytes of a safetensors file with these tensors: name, shape and values in row-major order.
///
/// # Errors
/// [`SafeTensorError`] if a tensor has another number of values than its shape.
pub fn encode<'a>(
    tensors: impl IntoIterator<Item = (&'a str, &'a [usize], &'a [f32])>,
    stored: Stored,
    metadata: HashMap<String, String>,
) -> Result<Vec<u8>, SafeTensorError> {
    let dtype = match stored {
        Stored::F16 => Dtype::F16,
        Stored::F32 => Dtype::F32,
    };
    let bytes = |values: &[f32]| -> Vec<u8> {
        match stored {
            Stored::F16 => values.iter().flat_map(|&x| f16::from_f32(x).to_le_bytes()).collect(),
            Stored::F32 => values.iter().flat_map(|x| x.to_le_bytes()).collect(),
        }
    };
    let encoded: Vec<_> =
        tensors.into_iter().map(|(name, shape, values)| (name, shape, bytes(values))).collect();
    let views = encoded
        .iter()
        .map(|(name, shape, bytes)| Ok((*name, TensorView::new(dtype, shape.to_vec(), bytes)?)))
        .collect::<Result<Vec<_>, SafeTensorError>>()?;
    safetensors::serialize(views, Some(metadata))
}

struct Tensor {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// The tensors of a model with its configuration; every value is finite.
pub struct Weights {
    tensors: BTreeMap<String, Tensor>,
    config: ModelConfig,
    card: Option<serde_json::Value>,
    sha256: String,
}

impl std::fmt::Debug for Weights {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Weights").field("sha256", &self.sha256).field("tensors", &self.tensors.len()).finish()
    }
}

impl Weights {
    /// Reads a weights file.
    ///
    /// # Errors
    /// [`WeightsError`] gives the cause and, if a tensor causes it, the tensor's name.
    pub fn open(path: &Path) -> Result<Self, WeightsError> {
        let bytes = std::fs::read(path)
            .map_err(|source| WeightsError::Unreadable { path: path.display().to_string(), source })?;
        Self::from_bytes(&bytes)
    }

    /// The weights that are embedded in the executable.
    ///
    /// # Panics
    /// Never in a build whose tests pass: they parse the same bytes.
    #[must_use]
    pub fn onboard() -> Self {
        Self::from_bytes(ONBOARD).expect("the embedded weights are checked by a test")
    }

    /// The file of the embedded weights.
    #[must_use]
    pub const fn onboard_file() -> &'static [u8] {
        ONBOARD
    }

    /// Reads a weights file, or takes the embedded weights if no file is given.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn open_or_onboard(path: Option<&Path>) -> Result<Self, WeightsError> {
        path.map_or_else(|| Ok(Self::onboard()), Self::open)
    }

    /// The weights of a run; they must belong to the run's `model`.
    ///
    /// # Errors
    /// [`WeightsError::OtherModel`] if they are not; else as [`Weights::open`].
    pub fn of_model(path: Option<&Path>, model: &ModelConfig) -> Result<Self, WeightsError> {
        let weights = Self::open_or_onboard(path)?;
        match difference(&weights.config, model) {
            Some((key, found, expected)) => Err(WeightsError::OtherModel { key, found, expected }),
            None => Ok(weights),
        }
    }

    /// Parses the bytes of a weights file.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let file = parse(bytes)?;
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let metadata = header.metadata().as_ref();
        let text = |key| metadata.and_then(|m| m.get(key));
        let config = text("config").ok_or(WeightsError::NoConfig)?;
        let config: ModelConfig = serde_json::from_str(config).map_err(WeightsError::Config)?;
        config.check()?;
        let card = text("card").map(|card| serde_json::from_str(card)).transpose();
        let card = card.map_err(WeightsError::Card)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let values = floats(name, view.dtype(), view.data())?;
            if let Some(index) = values.iter().position(|x| !x.is_finite()) {
                return Err(WeightsError::NotFinite { name: name.into(), index, value: values[index] });
            }
            tensors.insert(name.to_owned(), Tensor { shape: view.shape().to_vec(), values });
        }
        let sha256 = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { tensors, config, card, sha256 })
    }

    /// Builds all layers that run on board, as a check of names and shapes.
    ///
    /// # Errors
    /// [`WeightsError`] if a tensor is missing or has another shape than the model needs.
    pub fn check(&self) -> Result<(), WeightsError> {
        self.config.check_frames()?;
        StateMlp::new(self)?;
        RelationMlp::new(self)?;
        if self.config.context {
            ContextCnn::new(self)?;
        }
        Gdat::new(self)?;
        Decoder::new(self).map(drop)
    }

    /// The model's options.
    pub const fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// The model card, if the trainer wrote one: data, split, options and validation figures.
    pub const fn card(&self) -> Option<&serde_json::Value> {
        self.card.as_ref()
    }

    /// The licences of the data sets that the weights were trained on, by name; empty without a card.
    #[must_use]
    pub fn licences(&self) -> BTreeMap<String, String> {
        let licences = self.card.as_ref().and_then(|card| card.get("licences")).and_then(|l| l.as_object());
        let text = |(name, licence): (&String, &serde_json::Value)| {
            (name.clone(), licence.as_str().unwrap_or_default().to_owned())
        };
        licences.into_iter().flatten().map(text).collect()
    }

    /// Fingerprint of the file, in hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Names and shapes of all tensors, in the order of their names.
    pub fn shapes(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.tensors.iter().map(|(name, tensor)| (name.as_str(), tensor.shape.as_slice()))
    }

    /// A tensor's values in row-major order.
    ///
    /// # Errors
    /// [`WeightsError::Missing`], or [`WeightsError::Shape`] if the shape is not `shape`.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<&[f32], WeightsError> {
        let tensor = self.tensors.get(name).ok_or_else(|| WeightsError::Missing { name: name.into() })?;
        if tensor.shape == shape {
            Ok(&tensor.values)
        } else {
            Err(WeightsError::Shape {
                name: name.into(),
                found: tensor.shape.clone(),
                expected: shape.to_vec(),
            })
        }
    }
}

/// The first key in which two configurations differ, with both values.
fn difference(
    found: &ModelConfig,
    expected: &ModelConfig,
) -> Option<(String, serde_json::Value, serde_json::Value)> {
    if found == expected {
        return None;
    }
    let fields = |config| match serde_json::to_value(config) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (found, mut expected) = (fields(found), fields(expected));
    let mut differing = found.into_iter().filter(|(key, value)| expected.get(key) != Some(value));
    let (key, value) = differing.next().unwrap_or_default();
    let of_the_run = expected.remove(&key).unwrap_or_default();
    Some((key, value, of_the_run))
}

fn parse(bytes: &[u8]) -> Result<SafeTensors<'_>, WeightsError> {
    let header_len = match bytes.first_chunk::<LENGTH_BYTES>() {
        Some(len) => u64::from_le_bytes(*len),
        None => return Err(WeightsError::Truncated { found: bytes.len(), expected: LENGTH_BYTES }),
    };
    let begins_like_one = bytes.get(LENGTH_BYTES).is_none_or(|&first| first == b'{');
    if begins_like_one && header_len < 100_000_000 {
        let header_end = LENGTH_BYTES + header_len as usize;
        if bytes.len() < header_end {
            return Err(WeightsError::Truncated { found: bytes.len(), expected: header_end });
        }
        let expected = header_end.saturating_add(data_len(&bytes[LENGTH_BYTES..header_end]));
        if bytes.len() < expected {
            return Err(WeightsError::Truncated { found: bytes.len(), expected });
        }
    }
    Ok(SafeTensors::deserialize(bytes)?)
}

/// Size of the data according to a header; 0 if the header can't be parsed.
fn data_len(header: &[u8]) -> usize {
    let Ok(serde_json::Value::Object(tensors)) = serde_json::from_slice(header) else {
        return 0;
    };
    let ends = tensors.values().filter_map(|tensor| tensor.get("data_offsets")?.get(1)?.as_u64());
    ends.max().unwrap_or(0) as usize
}

fn floats(name: &str, dtype: Dtype, data: &[u8]) -> Result<Vec<f32>, WeightsError> {
    match dtype {
        Dtype::F32 => Ok(data.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()),
        Dtype::F16 => {
            Ok(data.as_chunks().0.iter().map(|&bytes| f16::from_le_bytes(bytes).to_f32()).collect())
        }
        other => Err(WeightsError::Type { name: name.into(), dtype: other }),
    }
}
