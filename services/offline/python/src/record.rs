//! Records of runs (MCAP).

use std::path::PathBuf;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::IntoPyObjectExt as _;
use pyo3::prelude::*;
use recording::{Ending, Message};
use wire::WorldOrigin;

use crate::error;
use crate::frame::Frame;

/// Messages that are read in advance.
const AHEAD: usize = 16;

/// A record of a run.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Record(Arc<recording::Recording>);

#[pymethods]
impl Record {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let opened = py.detach(move || recording::Recording::open(&path));
        opened.map(|record| Self(Arc::new(record))).map_err(|why| error::of(&why))
    }

    /// The description of the run, as JSON.
    fn about(&self) -> PyResult<String> {
        serde_json::to_string(self.0.about()).map_err(|why| error::of(&why))
    }

    /// Why the record is incomplete; `None` if it is complete.
    fn incomplete(&self) -> Option<&str> {
        match self.0.ending() {
            Ending::Complete { .. } => None,
            Ending::Incomplete { why, .. } => Some(why),
        }
    }

    /// The damaged parts of the file, which the messages leave out.
    fn damages(&self, py: Python<'_>) -> Vec<String> {
        py.detach(|| self.0.damages().iter().map(ToString::to_string).collect())
    }

    /// The frames of these topics, and events and log lines as JSON if `events` is set, in time order.
    fn messages(&self, topics: Vec<String>, events: bool) -> Messages {
        let record = self.0.clone();
        let origin = record.about().run.origin();
        let (sender, receiver) = std::sync::mpsc::sync_channel(AHEAD);
        std::thread::spawn(move || {
            let wanted = |message: &Message| match message {
                Message::Frame(frame) => topics.iter().any(|topic| topic == frame.topic().name),
                Message::Event(_) | Message::Line(_) => events,
                Message::Before(_) => false,
            };
            for message in record.messages().flatten().filter(wanted) {
                if sender.send(message).is_err() {
                    return;
                }
            }
        });
        Messages { receiver: Mutex::new(receiver), origin }
    }

    #[getter]
    fn interval_ns(&self) -> u64 {
        self.0.about().run.interval_ns
    }
}

/// Messages of a record, from a thread that reads the file.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Messages {
    receiver: Mutex<Receiver<Message>>,
    origin: WorldOrigin,
}

#[pymethods]
impl Messages {
    const fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let next = py.detach(|| self.receiver.lock().unwrap_or_else(PoisonError::into_inner).recv().ok());
        next.map(|message| to_python(py, message, self.origin)).transpose()
    }
}

/// A message as a frame, or as JSON.
pub fn to_python(py: Python<'_>, message: Message, origin: WorldOrigin) -> PyResult<Bound<'_, PyAny>> {
    let json = |made: serde_json::Result<String>| made.map_err(|why| error::of(&why))?.into_bound_py_any(py);
    match message {
        Message::Frame(frame) | Message::Before(frame) => Frame::new(frame, origin).into_bound_py_any(py),
        Message::Event(event) => json(serde_json::to_string(&event)),
        Message::Line(line) => json(serde_json::to_string(&line)),
    }
}
