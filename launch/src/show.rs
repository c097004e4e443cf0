use std::io::{ErrorKind, Write as _};
use std::path::Path;

use run::Exit;

use crate::failure::Failure;

/// Writes to standard output. A reader that closes the pipe early, as `head` does, is no failure.
pub fn show(text: &str) -> Result<Exit, Failure> {
    let mut output = std::io::stdout().lock();
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::output(Path::new("-"), error)),
        _ => Ok(Exit::Done),
    }
}
