//! Weights files, for models in PyTorch.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use console::failure::Failure;
use nn::{Stored, Weights, WeightsError, encode};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;

use crate::error::{self, InputError};

/// Name, shape and values of a tensor: 32-bit floats of this machine in row-major order.
type Tensor<V> = (String, Vec<usize>, V);

/// Configuration, card, fingerprint and tensors of a weights file.
type File<'py> = (String, Option<String>, String, Vec<Tensor<Bound<'py, PyBytes>>>);

/// The parts of a weights file; without a path of the embedded weights.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "pyo3 extracts owned paths")]
pub fn read_weights(py: Python<'_>, path: Option<PathBuf>) -> PyResult<File<'_>> {
    let weights = py
        .detach(|| Weights::open_or_onboard(path.as_deref()))
        .map_err(|why| of_weights(path.as_deref(), why))?;
    let config = serde_json::to_string(weights.config()).map_err(|why| error::of(&why))?;
    let mut tensors = Vec::new();
    for (name, shape) in weights.shapes() {
        let values = weights.tensor(name, shape).map_err(|why| error::of(&why))?;
        tensors.push((name.to_owned(), shape.to_vec(), PyBytes::new(py, bytemuck::cast_slice(values))));
    }
    Ok((config, weights.card().map(ToString::to_string), weights.sha256().to_owned(), tensors))
}

/// Writes a weights file and returns its fingerprint, if the program can run the model.
#[pyfunction]
#[expect(clippy::needless_pass_by_value, reason = "pyo3 extracts owned paths")]
pub fn write_weights(
    py: Python<'_>,
    path: PathBuf,
    config: String,
    card: Option<String>,
    tensors: Vec<Tensor<PyBackedBytes>>,
    half: bool,
) -> PyResult<String> {
    py.detach(|| {
        let values: Vec<(String, Vec<usize>, Vec<f32>)> =
            tensors.into_iter().map(|(name, shape, bytes)| (name, shape, floats(&bytes))).collect();
        let stored = if half { Stored::F16 } else { Stored::F32 };
        let mut metadata = HashMap::from([("config".to_owned(), config)]);
        metadata.extend(card.map(|card| ("card".to_owned(), card)));
        let tensors = values.iter().map(|(name, shape, values)| (&name[..], &shape[..], &values[..]));
        let bytes = encode(tensors, stored, metadata).map_err(|why| error::of(&why))?;
        let weights = Weights::from_bytes(&bytes).and_then(|weights| weights.check().map(|()| weights));
        let weights = weights.map_err(|why| of_weights(None, why))?;
        std::fs::write(&path, &bytes).map_err(|why| error::of_failure(&Failure::file(&path, why)))?;
        Ok(weights.sha256().to_owned())
    })
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks().0.iter().map(|&bytes| f32::from_ne_bytes(bytes)).collect()
}

fn of_weights(path: Option<&Path>, why: WeightsError) -> PyErr {
    match path {
        Some(path) => error::of_failure(&Failure::weights(path, why)),
        None => InputError::new_err(why.to_string()),
    }
}
