//! Output of verbs, without commands to the terminal: names of files, topics and tags come from outside. If the
//! reader closes its pipe early, as `head` does, a verb ends quietly and a run continues.

use std::io::{ErrorKind, Write as _};
use std::path::Path;

use run::Exit;

use crate::color;
use crate::failure::Failure;

/// Writes the result of a verb to standard output. A closed pipe is not an error.
pub fn show(text: &str) -> Result<Exit, Failure> {
    let mut output = std::io::stdout().lock();
    let text = ports::escaped(text, color::choice().is_on(&output));
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::output(Path::new("-"), error)),
        _ => Ok(Exit::Done),
    }
}

/// Whether the reader still accepts output. A closed pipe is not an error.
pub fn is_read(written: std::io::Result<()>) -> std::io::Result<bool> {
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true),
    }
}
