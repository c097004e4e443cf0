//! Figures of recordings.

use std::path::PathBuf;

use data::sets::Part;
use data::{FrameRate, OpenOptions};
use evaluator::{MapChoice, Options, WeightsChoice};
use nn::Precision;
use pyo3::prelude::*;

use crate::error;
use crate::recording::prepare;

/// Compares forecasts with the recorded motion, as `stgdat evaluate FILE…` does. `arguments` are the weights
/// and how the recordings are read. Returns the figures as JSON, the main table and all tables as Markdown,
/// and the doubts about the recordings.
#[pyfunction]
pub fn evaluate(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    arguments: Vec<String>,
    positions: bool,
    threads: Option<usize>,
) -> PyResult<(String, String, String, Vec<String>)> {
    py.detach(move || {
        let prepared = prepare(arguments)?;
        let (source, run) = (prepared.source, prepared.run);
        let fps = source.fps.map(FrameRate::new).transpose().map_err(|why| error::of(&why))?;
        let open = OpenOptions { format: source.format, fps, origin: run.origin() };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let options = Options {
            data: PathBuf::new(),
            part: Part::Test,
            weights: WeightsChoice {
                file: run.weights,
                folder: PathBuf::new(),
                precision: Precision::default(),
            },
            map: MapChoice::Site,
            lanes: false,
            threads: threads.unwrap_or(cores).max(1),
        };
        let report =
            evaluator::files(&options, &paths, open, positions, |_| ()).map_err(|why| error::of(&why))?;
        let tables = report.markdown();
        let brief = report.brief().unwrap_or_else(|| tables.clone());
        Ok((report.json().to_string(), brief, tables, report.warnings))
    })
}
