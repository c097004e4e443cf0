//! The batches of a training, for PyTorch.

use std::path::PathBuf;

use pyo3::prelude::*;
use pyo3::types::PyByteArray;
use serde_json::{Map, Value};
use trainer::{TrainOptions, Values};

use crate::error::{self, InputError};
use crate::recording::Recording;

/// Name, shape, whether the values are 32-bit floats and not 64-bit integers, and the values in row-major order.
type Array<'py> = (String, Vec<usize>, bool, Bound<'py, PyByteArray>);

/// Trajectory, single, probability and spread of a loss, the number of its agents, and its gradients.
type Gradients<'py> = ([f32; 4], usize, Vec<Array<'py>>);

/// The windows of recordings.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Windows(trainer::Windows);

#[pymethods]
impl Windows {
    /// `options` is a JSON object with options of `stgdat train FILE` that differ from its own.
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "pyo3 extracts owned lists")]
    fn new(py: Python<'_>, recordings: Vec<Py<Recording>>, options: &str) -> PyResult<Self> {
        py.detach(|| {
            let options = options_of(options).map_err(|why| InputError::new_err(why.to_string()))?;
            let recordings: Vec<&data::Recording> =
                recordings.iter().map(|recording| &recording.get().recording).collect();
            trainer::Windows::of(&recordings, options).map(Self).map_err(|why| error::of(&why))
        })
    }

    /// The number of windows and of agents in them that have a target.
    fn counts(&self) -> (usize, usize) {
        (self.0.window_count(), self.0.agent_count())
    }

    /// The arrays of a batch.
    fn batch<'py>(&self, py: Python<'py>, number: u64) -> PyResult<Vec<Array<'py>>> {
        let arrays = py.detach(|| self.0.batch(number)).map_err(|why| error::of(&why))?;
        let array = |array: trainer::Array| match array.values {
            Values::Numbers(values) => (array.name, array.shape, true, bytes(py, &values)),
            Values::Indices(values) => (array.name, array.shape, false, bytes(py, &values)),
        };
        Ok(arrays.into_iter().map(array).collect())
    }

    /// The trainer's loss and gradients of a batch for the weights in a file.
    #[expect(clippy::needless_pass_by_value, reason = "pyo3 extracts owned paths")]
    fn gradients<'py>(
        &self,
        py: Python<'py>,
        number: u64,
        weights: PathBuf,
        done: f32,
    ) -> PyResult<Gradients<'py>> {
        let found = py.detach(|| self.0.gradients(number, &weights, done)).map_err(|why| error::of(&why))?;
        let parts = found.parts;
        let parts = [parts.trajectory, parts.single, parts.probability, parts.spread];
        let gradients = found.gradients.into_iter();
        let gradients = gradients.map(|(name, shape, values)| (name, shape, true, bytes(py, &values)));
        Ok((parts, found.agents, gradients.collect()))
    }
}

fn bytes<'py, T: bytemuck::NoUninit>(py: Python<'py>, values: &[T]) -> Bound<'py, PyByteArray> {
    PyByteArray::new(py, bytemuck::cast_slice(values))
}

/// The options of a training on own recordings, with the changes of a JSON object.
fn options_of(changes: &str) -> serde_json::Result<TrainOptions> {
    let changes: Map<String, Value> = serde_json::from_str(changes)?;
    let mut options: Map<String, Value> =
        serde_json::from_value(serde_json::to_value(trainer::own(Vec::new()))?)?;
    options.extend(changes);
    let options: TrainOptions = serde_json::from_value(Value::Object(options))?;
    Ok(TrainOptions { checkpoints: std::env::temp_dir(), ..options })
}
