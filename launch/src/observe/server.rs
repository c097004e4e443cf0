//! Answers over HTTP/1.1: `/metrics` as text and `/status` as JSON, on an address or a Unix socket.
//!
//! One thread accepts connections. One more thread per connection asks the launcher and answers. The number
//! of connections, their duration and the request size are limited, so a client can't use too many resources.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use recorder::exposition::CONTENT_TYPE;

use super::{Asked, Question};
use crate::failure::Failure;

/// Maximum number of open connections; further ones are refused.
const CONNECTIONS_MAX: usize = 8;
/// Time limit for a client to ask and to read the answer.
const CLIENT_LIMIT: Duration = Duration::from_secs(2);
/// Time limit for the launcher to answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);
/// Maximum size of a request.
const REQUEST_BYTES_MAX: usize = 8 << 10;
/// Pause after a failed accept, for instance if descriptors run out.
const PAUSE: Duration = Duration::from_millis(200);

/// A connection with time limits on reads and writes.
trait Connection: Read + Write + Send + 'static {
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

/// An answer: status line, media type and body.
type Answer = (&'static str, &'static str, String);

const PLAIN: &str = "text/plain; charset=utf-8";
const JSON: &str = "application/json";

/// Answers on an address until the process ends.
///
/// # Errors
/// [`Failure::Unavailable`] if the address is taken or does not belong to this machine.
pub fn listen_tcp(address: SocketAddr, ask: SyncSender<Asked>) -> Result<(), Failure> {
    let failed = |error| Failure::unavailable_about(format!("metrics on {address}"), error);
    let listener = TcpListener::bind(address).map_err(failed)?;
    accept("metrics", move || listener.accept().map(|(stream, _)| stream), ask).map_err(failed)
}

/// Answers on a Unix socket until the process ends.
///
/// # Errors
/// [`Failure::Unavailable`] if the socket can't be created.
pub fn listen_unix(path: &Path, ask: SyncSender<Asked>) -> Result<(), Failure> {
    let failed = |error| Failure::unavailable_about(path.display(), error);
    let listener = UnixListener::bind(path).map_err(failed)?;
    accept("status", move || listener.accept().map(|(stream, _)| stream), ask).map_err(failed)
}

/// Starts the thread that accepts.
fn accept<C: Connection>(
    name: &str,
    next: impl Fn() -> io::Result<C> + Send + 'static,
    ask: SyncSender<Asked>,
) -> io::Result<()> {
    let connections = Arc::new(AtomicUsize::new(0));
    let follow = move || {
        loop {
            let Ok(connection) = next() else {
                thread::sleep(PAUSE);
                continue;
            };
            let slot = Slot::take(&connections);
            let ask = ask.clone();
            // Without a thread or slot, the connection is closed without an answer.
            if let Some(slot) = slot {
                let _ = thread::Builder::new().name("answer".to_owned()).spawn(move || {
                    // A client that disconnected is not an error.
                    let _ = answer(connection, &ask);
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

fn answer(mut connection: impl Connection, ask: &SyncSender<Asked>) -> io::Result<()> {
    let begun = Instant::now();
    let (line, has_body) = match request(&mut connection, begun)? {
        Some(request) => (route(&request, ask), !request.starts_with("HEAD ")),
        None => (("400 Bad Request", PLAIN, "not a request, or too long\n".to_owned()), true),
    };
    let (status, kind, body) = line;
    connection.limit(CLIENT_LIMIT)?;
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    connection.write_all(head.as_bytes())?;
    if has_body {
        connection.write_all(body.as_bytes())?;
    }
    connection.flush()
}

/// Reads a request's head and returns its first line; `None` if the head is too long or ends early.
fn request(connection: &mut impl Connection, begun: Instant) -> io::Result<Option<String>> {
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
    Ok(std::str::from_utf8(&bytes).ok().and_then(|text| text.lines().next()).map(str::to_owned))
}

/// Returns the answer to a request's first line.
fn route(line: &str, ask: &SyncSender<Asked>) -> Answer {
    let mut words = line.split(' ');
    let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    if !matches!(method, "GET" | "HEAD") {
        return ("405 Method Not Allowed", PLAIN, "only GET is answered\n".to_owned());
    }
    let path = target.split_once('?').map_or(target, |(path, _)| path);
    let (question, kind) = match path {
        "/metrics" => (Question::Metrics, CONTENT_TYPE),
        "/status" => (Question::Status, JSON),
        "/" => return ("200 OK", PLAIN, "stgdat: /metrics for Prometheus, /status as JSON\n".to_owned()),
        _ => return ("404 Not Found", PLAIN, "there is /metrics and /status\n".to_owned()),
    };
    match ask_launcher(question, ask) {
        Some(body) => ("200 OK", kind, body),
        None => ("503 Service Unavailable", PLAIN, "the launcher does not answer\n".to_owned()),
    }
}

/// Asks the launcher; `None` if it is too busy.
pub fn ask_launcher(question: Question, ask: &SyncSender<Asked>) -> Option<String> {
    let (reply, answered) = sync_channel(1);
    ask.try_send((question, reply)).ok()?;
    answered.recv_timeout(ANSWER_LIMIT).ok()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::Receiver;

    use super::*;

    /// A launcher that answers each question with its name.
    fn launcher(questions: Receiver<Asked>) {
        thread::spawn(move || {
            for (question, reply) in questions {
                let _ = reply.try_send(format!("{question:?}\n"));
            }
        });
    }

    fn answer_to(request: &[u8]) -> String {
        let (ask, questions) = sync_channel(4);
        launcher(questions);
        let (mut client, server) = UnixStream::pair().unwrap();
        let serving = thread::spawn(move || answer(server, &ask));
        client.write_all(request).unwrap();
        let _ = client.shutdown(std::net::Shutdown::Write);
        let mut text = String::new();
        let _ = client.read_to_string(&mut text);
        let _ = serving.join();
        text
    }

    #[test]
    fn metrics_and_status_are_answered_and_nothing_else() {
        let first =
            |request: &str| answer_to(request.as_bytes()).lines().next().unwrap_or_default().to_owned();
        assert!(answer_to(b"GET /metrics HTTP/1.1\r\nHost: a\r\n\r\n").ends_with("\r\n\r\nMetrics\n"));
        assert!(answer_to(b"GET /status?x=1 HTTP/1.0\r\n\r\n").ends_with("\r\n\r\nStatus\n"));
        assert!(answer_to(b"HEAD /metrics HTTP/1.1\r\n\r\n").ends_with("\r\n\r\n"));
        assert_eq!(first("GET /else HTTP/1.1\r\n\r\n"), "HTTP/1.1 404 Not Found");
        assert_eq!(first("POST /metrics HTTP/1.1\r\n\r\n"), "HTTP/1.1 405 Method Not Allowed");
        assert_eq!(first("nonsense"), "HTTP/1.1 400 Bad Request");
        assert_eq!(first(&"x".repeat(REQUEST_BYTES_MAX + 1)), "HTTP/1.1 400 Bad Request");
    }

    #[test]
    fn a_launcher_that_is_too_busy_gives_503() {
        let (ask, _questions) = sync_channel(0);
        assert_eq!(route("GET /metrics HTTP/1.1", &ask).0, "503 Service Unavailable");
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
