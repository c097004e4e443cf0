//! Failures as Python exceptions.

use std::error::Error;

use console::failure::Failure;
use data::ReadError;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

pyo3::create_exception!(
    stgdat,
    InputError,
    PyValueError,
    "Input that cannot be used: a file, a value in a file, or an argument.\n\nThe message names file, line and \
     value. The attributes `path`, `line` and `value` hold them for an error in a recording, else `None`."
);

/// The exception of a failure.
pub fn of_failure(failure: &Failure) -> PyErr {
    let message = failure.message();
    let inner: Option<&(dyn Error + 'static)> = match failure {
        Failure::Data(cause) => Some(cause.as_ref()),
        other => other.source(),
    };
    with_place(message.strip_prefix("error: ").unwrap_or(&message), read_error(inner))
}

/// The exception of an error.
pub fn of(error: &(dyn Error + 'static)) -> PyErr {
    with_place(&error.to_string(), read_error(Some(error)))
}

/// The error of a recording among an error and its causes.
fn read_error<'a>(mut error: Option<&'a (dyn Error + 'static)>) -> Option<&'a ReadError> {
    while let Some(found) = error {
        if let Some(read) = found.downcast_ref() {
            return Some(read);
        }
        error = found.source();
    }
    None
}

fn with_place(message: &str, read: Option<&ReadError>) -> PyErr {
    let place = read.map(ReadError::place);
    let message = message.to_owned();
    Python::attach(|py| {
        let error = InputError::new_err(message);
        let value = error.value(py);
        let (path, line, text) =
            place.map_or((None, None, None), |place| (Some(place.path), place.line, place.value));
        let set = value
            .setattr("path", path)
            .and_then(|()| value.setattr("line", line))
            .and_then(|()| value.setattr("value", text));
        set.map_or_else(|failed| failed, |()| error)
    })
}
