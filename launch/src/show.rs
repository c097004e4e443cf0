//! Output of verbs, without commands to the terminal: names of files, topics and tags come from outside. If the
//! reader closes its pipe early, as `head` does, a verb ends quietly and a run continues.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _};
use std::path::Path;

use run::Exit;

use crate::color;
use crate::failure::Failure;
use crate::streams::{self, Stream};

/// Prints a line on standard output. The line is dropped if nobody can read it.
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => { $crate::show::say(format_args!($($text)*)) };
}

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

/// As [`say!`].
pub fn say(line: Arguments<'_>) {
    // The verb's work is done, even if nobody reads the output.
    let text = format!("{line}\n");
    let text = ports::escaped(&text, color::choice().is_on(&std::io::stdout()));
    let _ = streams::write(Stream::Output, None, &text);
}
