//! Memory that numpy reads in place.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use recording::Frame;
use wire::{Detection, Header};

/// Bytes that Rust owns. numpy keeps the block alive as long as an array uses its memory.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Block {
    owner: Owner,
    /// Bytes of an element.
    item: usize,
}

/// The owner of the bytes.
pub enum Owner {
    /// The header of a frame.
    Header(Frame),
    /// The elements of a frame.
    Elements(Frame),
    /// Detections of a recording.
    Detections(Arc<[Detection]>),
    /// Numbers.
    Numbers(Arc<[i64]>),
}

impl Block {
    /// The bytes of `owner`.
    pub fn new(owner: Owner) -> Self {
        let item = match &owner {
            Owner::Header(_) => size_of::<Header>(),
            Owner::Elements(frame) => frame.element_bytes(),
            Owner::Detections(_) => size_of::<Detection>(),
            Owner::Numbers(_) => size_of::<i64>(),
        };
        Self { owner, item }
    }

    fn bytes(&self) -> &[u8] {
        match &self.owner {
            Owner::Header(frame) => &frame.bytes()[..size_of::<Header>()],
            Owner::Elements(frame) => frame.payload(),
            Owner::Detections(detections) => bytemuck::cast_slice(detections),
            Owner::Numbers(numbers) => bytemuck::cast_slice(numbers),
        }
    }
}

#[pymethods]
impl Block {
    /// The place of the bytes, as numpy reads it: read-only.
    #[getter]
    fn __array_interface__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let bytes = self.bytes();
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("data", (bytes.as_ptr() as usize, true))?;
        interface.set_item("shape", (bytes.len() / self.item,))?;
        interface.set_item("typestr", format!("|V{}", self.item))?;
        Ok(interface)
    }
}
