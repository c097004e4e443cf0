//! A small HTTP/1.1 server over blocking sockets.
//!
//! One thread accepts connections, and one more thread per connection answers. The number of connections, the
//! size of a request and the time of a read or write are limited, so a client can't use too many resources.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Maximum number of open connections; further ones are closed without an answer.
pub const CONNECTIONS_MAX: usize = 8;
/// Time limit for a client to ask, and to read the answer.
pub const CLIENT_LIMIT: Duration = Duration::from_secs(2);
/// Maximum size of a request.
pub const REQUEST_BYTES_MAX: usize = 8 << 10;
/// Pause after a failed accept, for instance if descriptors run out.
const PAUSE: Duration = Duration::from_millis(200);

/// Media type of plain text.
pub const PLAIN: &str = "text/plain; charset=utf-8";

/// A connection with time limits on reads and writes.
pub trait Connection: Read + Write + Send + 'static {
    /// Limits the time of each later read and write.
    ///
    /// # Errors
    /// The system's error.
    fn limit(&self, time: Duration) -> io::Result<()>;
}

impl Connection for TcpStream {
    fn limit(&self, time: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(time)).and_then(|()| self.set_write_timeout(Some(time)))
    }
}

impl Connection for UnixStream {
    fn limit(&self, time: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(time)).and_then(|()| self.set_write_timeout(Some(time)))
    }
}

/// The head of a request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    head: String,
}

impl Request {
    fn words(&self) -> impl Iterator<Item = &str> {
        self.head.lines().next().unwrap_or_default().split(' ')
    }

    /// The method, such as `GET`.
    #[must_use]
    pub fn method(&self) -> &str {
        self.words().next().unwrap_or_default()
    }

    /// The path, without the query.
    #[must_use]
    pub fn path(&self) -> &str {
        let target = self.words().nth(1).unwrap_or_default();
        target.split_once('?').map_or(target, |(path, _)| path)
    }

    /// The value of a key of the query.
    #[must_use]
    pub fn query(&self, key: &str) -> Option<&str> {
        let (_, query) = self.words().nth(1)?.split_once('?')?;
        query.split('&').filter_map(|pair| pair.split_once('=')).find(|(name, _)| *name == key).map(|of| of.1)
    }

    /// The value of a header line.
    #[must_use]
    pub fn header(&self, name: &str) -> Option<&str> {
        let lines = self.head.lines().skip(1).filter_map(|line| line.split_once(':'));
        lines.into_iter().find(|(key, _)| key.eq_ignore_ascii_case(name)).map(|(_, value)| value.trim())
    }
}

/// Starts the thread that accepts connections until the process ends, with a thread for each connection.
/// `None` instead of a request means that the head is too long or ends early.
///
/// # Errors
/// The system's error if the thread can't be started.
pub fn accept<C: Connection>(
    name: &str,
    next: impl Fn() -> io::Result<C> + Send + 'static,
    answer: impl Fn(C, Option<Request>) -> io::Result<()> + Send + Sync + 'static,
) -> io::Result<()> {
    let connections = Arc::new(AtomicUsize::new(0));
    let answer = Arc::new(answer);
    let follow = move || {
        loop {
            let Ok(mut connection) = next() else {
                thread::sleep(PAUSE);
                continue;
            };
            let answer = Arc::clone(&answer);
            // Without a thread or slot, the connection is closed without an answer.
            if let Some(slot) = Slot::take(&connections) {
                let _ = thread::Builder::new().name("answer".to_owned()).spawn(move || {
                    // A client that disconnected is not an error.
                    let _ = read(&mut connection).and_then(|request| answer(connection, request));
                    drop(slot);
                });
            }
        }
    };
    thread::Builder::new().name(name.to_owned()).spawn(follow).map(drop)
}

/// One of the allowed open connections.
struct Slot(Arc<AtomicUsize>);

impl Slot {
    fn take(taken: &Arc<AtomicUsize>) -> Option<Self> {
        let slot = Self(taken.clone());
        // Dropping the slot releases it, even if it exceeded the limit.
        (slot.0.fetch_add(1, Ordering::AcqRel) < CONNECTIONS_MAX).then_some(slot)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Reads the head of a request; `None` if the head is too long or ends early.
///
/// # Errors
/// The system's error, also if the client takes longer than [`CLIENT_LIMIT`].
pub fn read(connection: &mut impl Connection) -> io::Result<Option<Request>> {
    let begun = Instant::now();
    let mut bytes = Vec::new();
    let mut block = [0; 1024];
    while !bytes.windows(4).any(|end| end == b"\r\n\r\n") {
        let left = CLIENT_LIMIT.saturating_sub(begun.elapsed());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        connection.limit(left)?;
        let len = connection.read(&mut block)?;
        if len == 0 || bytes.len() + len > REQUEST_BYTES_MAX {
            return Ok(None);
        }
        bytes.extend_from_slice(&block[..len]);
    }
    Ok(String::from_utf8(bytes).ok().map(|head| Request { head }))
}

/// Answers with a whole body. `headers` are further header lines, each with its line end. The answer to `HEAD`
/// has no body.
///
/// # Errors
/// The system's error.
pub fn respond(
    connection: &mut impl Connection,
    method: &str,
    status: &str,
    (kind, headers): (&str, &str),
    body: &str,
) -> io::Result<()> {
    connection.limit(CLIENT_LIMIT)?;
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\n{headers}Connection: close\r\n\r\n",
        body.len()
    );
    connection.write_all(head.as_bytes())?;
    if method != "HEAD" {
        connection.write_all(body.as_bytes())?;
    }
    connection.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(bytes: &[u8]) -> Option<Request> {
        let (mut client, mut server) = UnixStream::pair().unwrap();
        client.write_all(bytes).unwrap();
        client.shutdown(std::net::Shutdown::Write).unwrap();
        read(&mut server).unwrap()
    }

    #[test]
    fn a_request_has_its_parts_and_a_limit() {
        let found = request(b"GET /events?a=1&token=xy HTTP/1.1\r\nhost: 127.0.0.1:80\r\n\r\n").unwrap();
        assert_eq!((found.method(), found.path()), ("GET", "/events"));
        assert_eq!((found.query("token"), found.query("b")), (Some("xy"), None));
        assert_eq!((found.header("Host"), found.header("Accept")), (Some("127.0.0.1:80"), None));
        assert_eq!(request(b"nonsense"), None);
        assert_eq!(request(&vec![b'x'; REQUEST_BYTES_MAX + 1]), None);
    }

    #[test]
    fn slots_are_limited_and_given_back() {
        let taken = Arc::new(AtomicUsize::new(0));
        let slots: Vec<Slot> = (0..CONNECTIONS_MAX).filter_map(|_| Slot::take(&taken)).collect();
        assert_eq!(slots.len(), CONNECTIONS_MAX);
        assert!(Slot::take(&taken).is_none());
        drop(slots);
        assert!(Slot::take(&taken).is_some());
    }
}
