//! Live runs.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use launch::runs;
use pyo3::exceptions::{PyConnectionError, PyEOFError};
use pyo3::prelude::*;
use recording::tap::{Client, Item, Request};
use recording::{About, Message};
use wire::WorldOrigin;

use crate::error;
use crate::record::to_python;

/// Longest wait without a look at Python's signals.
const WAIT: Duration = Duration::from_millis(100);

/// Name, folder and description (JSON) of the run with this name or folder; of the only one without a name.
#[pyfunction]
pub fn living_run(name: Option<&str>) -> PyResult<(String, PathBuf, String)> {
    let run = runs::find(name.map(Path::new)).map_err(|failure| error::of_failure(&failure))?;
    let about = About::of_run(&run.root).map_err(|why| error::of(&why))?;
    let about = serde_json::to_string(&about).map_err(|why| error::of(&why))?;
    Ok((run.name, run.root, about))
}

/// A connection to the tap of a run.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Tap {
    client: Mutex<Client>,
    origin: WorldOrigin,
}

#[pymethods]
impl Tap {
    #[new]
    fn new(root: &str, topics: Vec<String>, events: bool) -> PyResult<Self> {
        let root = Path::new(root);
        let about = About::of_run(root).map_err(|why| error::of(&why))?;
        let client = attach(root, topics, events)?;
        Ok(Self { client: Mutex::new(client), origin: about.run.origin() })
    }

    /// The next frame, or an event or log line as JSON; the number of frames that this program was too slow
    /// for; `None` after `timeout_s`.
    ///
    /// Raises `EOFError` after the end of the run.
    fn next<'py>(&self, py: Python<'py>, timeout_s: f64) -> PyResult<Option<Bound<'py, PyAny>>> {
        let mut left = Duration::try_from_secs_f64(timeout_s).unwrap_or(Duration::MAX);
        loop {
            let wait = left.min(WAIT);
            let (item, is_closed) = py.detach(|| {
                let mut client = self.client.lock().unwrap_or_else(PoisonError::into_inner);
                (client.next(wait), client.is_closed())
            });
            let broken = |why: recording::tap::TapError| PyConnectionError::new_err(why.to_string());
            let message = match item.map_err(broken)? {
                Some(Item::Frame(frame)) => Message::Frame(frame),
                Some(Item::Event(event)) => Message::Event(event),
                Some(Item::Line(line)) => Message::Line(line),
                Some(Item::Lost(lost)) => {
                    return lost
                        .frames
                        .into_pyobject(py)
                        .map(|frames| Some(frames.into_any()))
                        .map_err(Into::into);
                }
                Some(Item::Refused(why)) => return Err(PyConnectionError::new_err(why)),
                Some(Item::Attached | Item::Marked(_)) => continue,
                None if is_closed => return Err(PyEOFError::new_err("the run has ended")),
                None => {
                    py.check_signals()?;
                    left = left.saturating_sub(wait);
                    if left.is_zero() {
                        return Ok(None);
                    }
                    continue;
                }
            };
            return to_python(py, message, self.origin).map(Some);
        }
    }
}

fn attach(root: &Path, topics: Vec<String>, events: bool) -> PyResult<Client> {
    let tool = "python".to_owned();
    let request = Request { tool, topics, events, mark: None, recording: None };
    Client::attach(root, &request).map_err(|why| PyConnectionError::new_err(why.to_string()))
}
