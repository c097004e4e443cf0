//! Figures of recordings.

use std::borrow::Cow;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::Arc;

use data::OpenOptions;
use evaluator::{Evaluation, ForecastLines, MapChoice, Options, State, StateError, WeightsChoice};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;

use crate::error;
use crate::recording::{Recording, detections_of, parse, record_at};

/// States that are merged while the global lock is released.
const TOGETHER: usize = 256;

/// An evaluation of recordings, as `stgdat evaluate FILE…` does it, with loaded weights.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Evaluator {
    evaluation: Evaluation,
    open: OpenOptions,
    lines: Option<Arc<ForecastLines>>,
}

#[pymethods]
impl Evaluator {
    /// `arguments` are the weights, the lanes and how recordings are read. `has_map` states whether the
    /// network reads the online map. `lines` is a file for every forecast behind the tables.
    #[new]
    fn new(
        py: Python<'_>,
        arguments: Vec<String>,
        has_map: bool,
        positions: bool,
        threads: Option<usize>,
        lines: Option<PathBuf>,
    ) -> PyResult<Self> {
        py.detach(|| {
            let arguments = parse(arguments)?;
            let open = arguments.read().options();
            let run = arguments.prepare().map_err(|why| error::of_failure(&why))?.run;
            let lines = lines
                .map(|path| Ok::<_, PyErr>(Arc::new(ForecastLines::to(BufWriter::new(File::create(path)?)))));
            let lines = lines.transpose()?;
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let options = Options {
                weights: WeightsChoice { file: run.weights, ..WeightsChoice::default() },
                map: if has_map { MapChoice::Online } else { MapChoice::None },
                threads: threads.unwrap_or(cores).max(1),
                lines: lines.clone(),
                ..Options::default()
            };
            let mut evaluation = Evaluation::new(&options, positions).map_err(|why| error::of(&why))?;
            let lanes = arguments.model().open_lanes(open.origin).map_err(|why| error::of_failure(&why))?;
            if let Some(lanes) = lanes {
                evaluation = evaluation.along(Arc::new(lanes));
            }
            Ok(Self { evaluation, open, lines })
        })
    }

    /// The state of a recording that is already read. `name` is its name in tables.
    fn state_of(
        &self,
        py: Python<'_>,
        recording: &Recording,
        name: Option<String>,
    ) -> PyResult<Cow<'static, [u8]>> {
        py.detach(move || {
            let mut recording = recording.recording.clone();
            recording.name = name.unwrap_or(recording.name);
            Ok(self.evaluation.opened(recording).to_bytes().into())
        })
    }

    /// The state of one recording, or of the detections of a record. `name` is its name in tables.
    fn state(&self, py: Python<'_>, path: PathBuf, name: Option<String>) -> PyResult<Cow<'static, [u8]>> {
        py.detach(move || {
            let mut recording = match record_at(&path)? {
                Some(record) => detections_of(&record)?,
                None => data::open_with(&path, self.open.clone()).map_err(|why| error::of(&why))?,
            };
            recording.name = name.unwrap_or(recording.name);
            Ok(self.evaluation.opened(recording).to_bytes().into())
        })
    }

    /// The state of recordings, of which some may fail.
    fn states(&self, py: Python<'_>, paths: Vec<PathBuf>) -> PyResult<Cow<'static, [u8]>> {
        py.detach(move || {
            let state = self.evaluation.recordings(&paths, &self.open, |_| ());
            Ok(state.map_err(|why| error::of(&why))?.to_bytes().into())
        })
    }

    /// Ends the file of forecasts.
    fn finish_lines(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.lines.as_ref().map_or(Ok(()), |lines| lines.finish()))?;
        Ok(())
    }
}

/// Merges states, and adds recordings that failed with their reasons.
#[pyfunction]
pub fn combine(
    py: Python<'_>,
    states: &Bound<'_, PyAny>,
    failures: Vec<(String, String)>,
) -> PyResult<Cow<'static, [u8]>> {
    let (mut states, mut whole, mut number) = (states.try_iter()?, None, 0);
    loop {
        let taken = states.by_ref().take(TOGETHER).map(|state| Ok(state?.extract::<PyBackedBytes>()?));
        let taken: Vec<PyBackedBytes> = taken.collect::<PyResult<_>>()?;
        let is_last = taken.len() < TOGETHER;
        let read = |(place, bytes): (usize, &PyBackedBytes)| {
            let name = format!("states[{}]", number + place);
            Ok((name.clone(), State::from_bytes(&name, bytes)?))
        };
        if !taken.is_empty() || whole.is_none() {
            let merge = || {
                let before = whole.take().map(|state| Ok(("states[0]".to_owned(), state)));
                State::merged(before.into_iter().chain(taken.iter().enumerate().map(read)))
            };
            whole = Some(py.detach(merge).map_err(|why: StateError| error::of(&why))?);
        }
        number += taken.len();
        if is_last {
            break;
        }
    }
    let Some(mut whole) = whole else { return Err(error::of(&StateError::None)) };
    failures.into_iter().for_each(|(name, reason)| whole.add_failure(&name, &reason));
    Ok(whole.to_bytes().into())
}

/// The figures of a state as JSON; what `stgdat evaluate` prints, its main table, all tables; and the doubts.
#[pyfunction]
pub fn report(
    py: Python<'_>,
    state: PyBackedBytes,
) -> PyResult<(String, String, String, String, Vec<String>)> {
    py.detach(move || {
        let report = State::from_bytes("state", &state).map_err(|why| error::of(&why))?.report();
        let tables = report.markdown();
        let brief = report.brief().unwrap_or_else(|| tables.clone());
        Ok((report.json().to_string(), report.text(), brief, tables, report.warnings))
    })
}
