use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use thiserror::Error;

use super::protocol::{Item, ItemError, Request, SOCKET, take};

/// Bytes read at a time.
const BLOCK: usize = 1 << 18;

/// A tool's connection to the tap of a run.
#[derive(Debug)]
pub struct Client {
    socket: UnixStream,
    path: PathBuf,
    buffer: Vec<u8>,
    /// Consumed bytes of the buffer.
    taken: usize,
    is_closed: bool,
}

/// Why a tool receives nothing.
#[derive(Debug, Error)]
pub enum TapError {
    /// The tap can't be reached.
    #[error("{}: {source}", path.display())]
    Socket {
        /// Socket.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The tap has another version.
    #[error("{}: {source}", path.display())]
    Item {
        /// Socket.
        path: PathBuf,
        /// The error in the received bytes.
        source: ItemError,
    },
}

impl Client {
    /// Attaches to the tap of the run with this folder.
    ///
    /// # Errors
    /// [`TapError::Socket`] if there is no tap.
    pub fn attach(root: &Path, request: &Request) -> Result<Self, TapError> {
        let path = root.join(SOCKET);
        let attached = UnixStream::connect(&path).and_then(|mut socket| {
            let mut line = serde_json::to_vec(request)?;
            line.push(b'\n');
            socket.write_all(&line)?;
            Ok(socket)
        });
        match attached {
            Ok(socket) => Ok(Self { socket, path, buffer: Vec::new(), taken: 0, is_closed: false }),
            Err(source) => Err(TapError::Socket { path, source }),
        }
    }

    /// The next item. Waits at most `timeout`; `None` if no item arrived or the tap has closed.
    ///
    /// # Errors
    /// [`TapError`] if the tap can't be read from.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Item>, TapError> {
        let until = Instant::now() + timeout;
        loop {
            let found = take(&self.buffer[self.taken..]);
            match found.map_err(|source| TapError::Item { path: self.path.clone(), source })? {
                Some((item, len)) => {
                    self.taken += len;
                    return Ok(Some(item));
                }
                None if self.is_closed => return Ok(None),
                None => {}
            }
            self.buffer.drain(..self.taken);
            self.taken = 0;
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() || !self.fill(left)? {
                return Ok(None);
            }
        }
    }

    /// Whether the tap has closed: the run has ended, or the tap has died.
    pub const fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Reads the available bytes; `false` if none arrived in time.
    fn fill(&mut self, timeout: Duration) -> Result<bool, TapError> {
        let begin = self.buffer.len();
        self.buffer.resize(begin + BLOCK, 0);
        let read = self
            .socket
            .set_read_timeout(Some(timeout.max(Duration::from_millis(1))))
            .and_then(|()| self.socket.read(&mut self.buffer[begin..]));
        self.buffer.truncate(begin + read.as_ref().map_or(0, |len| *len));
        match read {
            Ok(0) => {
                self.is_closed = true;
                Ok(true)
            }
            Ok(_) => Ok(true),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(false),
            // A signal: the caller checks whether it must end.
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(false),
            Err(error) if error.kind() == ErrorKind::ConnectionReset => {
                self.is_closed = true;
                Ok(true)
            }
            Err(source) => Err(TapError::Socket { path: self.path.clone(), source }),
        }
    }
}
