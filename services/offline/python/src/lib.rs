//! The compiled part of the Python package `stgdat`: the same crates as `stgdat predict`, `track`,
//! `evaluate` and `record`, behind a few classes. The Python files beside this crate give it types,
//! documentation and numpy arrays.
//!
//! A frame holds header and elements of one topic, whatever made it: a recording, the stages in this
//! process, a file of a run, or a live run. Its memory is a block, which numpy reads in place.
//! Computations release Python's global lock.

mod block;
mod columns;
mod error;
mod evaluate;
mod fleet;
mod frame;
mod lanes;
mod layout;
mod live;
mod record;
mod recording;
mod stages;
mod weights;
mod windows;

#[pyo3::pymodule]
mod _stgdat {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::block::Block;
    #[pymodule_export]
    use crate::columns::{column_of, parse_columns, write_columns};
    #[pymodule_export]
    use crate::error::InputError;
    #[pymodule_export]
    use crate::evaluate::{Evaluator, combine, report};
    #[pymodule_export]
    use crate::fleet::{check, compare, cut, differences, inspect, learn, outcomes, priors, worst};
    #[pymodule_export]
    use crate::frame::{Frame, detections, doubts_of, frame};
    #[pymodule_export]
    use crate::lanes::lanes;
    #[pymodule_export]
    use crate::layout::{constants, layout, numbers};
    #[pymodule_export]
    use crate::live::{Tap, living_run};
    #[pymodule_export]
    use crate::record::{Messages, Record};
    #[pymodule_export]
    use crate::recording::{Playback, Recording, open, split};
    #[pymodule_export]
    use crate::stages::{Predictor, Tracker};
    #[pymodule_export]
    use crate::weights::{read_weights, write_weights};
    #[pymodule_export]
    use crate::windows::Windows;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // For errors that are in no file.
        let error = module.py().get_type::<InputError>();
        ["path", "line", "value"].iter().try_for_each(|name| error.setattr(name, module.py().None()))?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
