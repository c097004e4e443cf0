//! Standard output and standard error of a process that must not wait, such as the launcher.
//!
//! Without [`never_wait`], a write waits for the reader, as is usual for a command whose output is its result.

use std::collections::BTreeMap;
use std::fmt::Arguments;
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::fs::fstat;

use supervisor::{Origin, Outlet, QUEUE_BYTES_MAX};

use crate::color;

/// Prints a line on standard output. The line is dropped if nobody can read it.
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => { $crate::streams::say(format_args!($($text)*)) };
}

/// Time for the reader of the output to take the last lines, at the end of the process.
const END_LIMIT: Duration = Duration::from_secs(1);

/// A standard stream.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Standard output.
    Output,
    /// Standard error.
    Error,
}

/// The outlets of a process that must not wait.
static OUTLETS: OnceLock<[Outlet; 2]> = OnceLock::new();

/// From now on, threads write both streams.
///
/// # Errors
/// The system's error if the threads can't be started.
pub fn never_wait() -> io::Result<()> {
    let (output, error) = (io::stdout(), io::stderr());
    // The copies are written without the locks of `std`, so a write that waits does not hold them.
    let open = |name, file: BorrowedFd<'_>| {
        Outlet::open(name, QUEUE_BYTES_MAX, File::from(file.try_clone_to_owned()?))
    };
    let first = open("output", output.as_fd())?;
    // Lines for one terminal stay in order.
    let second =
        if is_same(output.as_fd(), error.as_fd()) { first.clone() } else { open("log", error.as_fd())? };
    let _ = OUTLETS.set([first, second]);
    Ok(())
}

fn is_same(one: BorrowedFd<'_>, other: BorrowedFd<'_>) -> bool {
    let file = |stream| fstat(stream).ok().map(|file| (file.st_dev, file.st_ino));
    file(one).is_some() && file(one) == file(other)
}

/// Writes whole lines. Returns false if they are discarded.
pub fn write(stream: Stream, origin: Origin, text: &str) -> bool {
    match (OUTLETS.get(), stream) {
        (Some([output, _]), Stream::Output) => output.push(origin, text.into()),
        (Some([_, error]), Stream::Error) => error.push(origin, text.into()),
        (None, Stream::Output) => {
            let mut output = io::stdout().lock();
            let written = output.write_all(text.as_bytes()).and_then(|()| output.flush());
            written.map_err(fail).is_ok()
        }
        (None, Stream::Error) => io::stderr().lock().write_all(text.as_bytes()).is_ok(),
    }
}

/// As [`say!`].
pub fn say(line: Arguments<'_>) {
    // The verb's work is done, even if nobody reads the output.
    let text = format!("{line}\n");
    let text = ports::escaped(&text, color::choice().is_on(&std::io::stdout()));
    let _ = write(Stream::Output, None, &text);
}

/// The first error of standard output, other than a closed pipe.
static FAILED: Mutex<Option<io::Error>> = Mutex::new(None);

/// Remembers an error of standard output.
fn fail(error: io::Error) {
    if error.kind() != io::ErrorKind::BrokenPipe {
        FAILED.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// Why lines of standard output are missing, once.
pub fn failed() -> Option<io::Error> {
    FAILED.lock().unwrap_or_else(PoisonError::into_inner).take()
}

/// Numbers of discarded lines of the log, by origin.
pub fn lost() -> BTreeMap<Origin, u64> {
    OUTLETS.get().map(|[_, error]| error.lost()).unwrap_or_default()
}

/// Waits until all lines are written, but at most a second.
pub fn finish() {
    let begun = Instant::now();
    for outlet in OUTLETS.get().into_iter().flatten() {
        outlet.flush(END_LIMIT.saturating_sub(begun.elapsed()));
    }
}
