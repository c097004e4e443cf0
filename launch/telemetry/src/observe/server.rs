//! Answers over HTTP/1.1: `/metrics` as text and `/status` as JSON, on an address or a Unix socket.

use std::io;
use std::net::{SocketAddr, TcpListener};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Duration;

use ports::is_own_user;
use recorder::exposition::CONTENT_TYPE;
use view::http::{Connection, PLAIN, Request, accept, respond};
use view::is_direct;

use console::failure::Failure;

/// Time limit for the launcher to answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(1);

/// An answer: status line, media type and body.
type Answer = (&'static str, &'static str, String);

const JSON: &str = "application/json";

/// Answers on an address until the process ends.
///
/// # Errors
/// [`Failure::Unavailable`] if the address is taken or does not belong to this machine.
pub fn listen_tcp(address: SocketAddr, ask: SyncSender<Asked>) -> Result<(), Failure> {
    let failed = |error| Failure::unavailable_about(format!("metrics on {address}"), error);
    let listener = TcpListener::bind(address).map_err(failed)?;
    let next = move || listener.accept().map(|(stream, _)| stream);
    accept("metrics", next, move |connection, request| {
        // A page of a foreign site may have had its own name point here.
        match request.as_ref().is_none_or(is_direct) {
            true => answer(connection, request.as_ref(), &ask),
            false => refuse(connection),
        }
    })
    .map_err(failed)
}

/// The file of a Unix socket, removed when it is dropped.
pub struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Answers this user and root on a Unix socket until the process ends.
///
/// # Errors
/// [`Failure::Unavailable`] if the socket can't be created.
pub fn listen_unix(path: &Path, ask: SyncSender<Asked>) -> Result<SocketFile, Failure> {
    let failed = |error| Failure::unavailable_about(path.display(), error);
    // A killed run leaves a socket on which nobody listens.
    if UnixStream::connect(path).is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused) {
        std::fs::remove_file(path).map_err(failed)?;
    }
    let listener = UnixListener::bind(path).map_err(failed)?;
    let file = SocketFile(path.to_owned());
    let next = move || loop {
        let (stream, _) = listener.accept()?;
        if is_own_user(&stream) {
            return Ok(stream);
        }
    };
    accept("status", next, move |connection, request| answer(connection, request.as_ref(), &ask))
        .map_err(failed)?;
    Ok(file)
}

/// Refuses a request to another name.
fn refuse(mut connection: impl Connection) -> io::Result<()> {
    let why = "the request names another host: use the address of this machine as a number, or localhost\n";
    respond(&mut connection, "GET", "403 Forbidden", (PLAIN, ""), why)
}

fn answer(
    mut connection: impl Connection,
    request: Option<&Request>,
    ask: &SyncSender<Asked>,
) -> io::Result<()> {
    let bad = || ("400 Bad Request", PLAIN, "not a request, or too long\n".to_owned());
    let (status, kind, body) = request.map_or_else(bad, |request| route(request, ask));
    let method = request.map_or("GET", Request::method);
    respond(&mut connection, method, status, (kind, ""), &body)
}

/// Returns the answer to a request.
fn route(request: &Request, ask: &SyncSender<Asked>) -> Answer {
    if !matches!(request.method(), "GET" | "HEAD") {
        return ("405 Method Not Allowed", PLAIN, "only GET is answered\n".to_owned());
    }
    let (question, kind) = match request.path() {
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

/// A question about a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// The metrics, as text.
    Metrics,
    /// The status, as JSON.
    Status,
}

/// A question, with the channel for its answer.
pub type Asked = (Question, SyncSender<String>);

/// Name of the status socket in a run's folder.
pub const SOCKET: &str = "status";

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::os::unix::net::UnixStream;
    use std::sync::mpsc::Receiver;
    use std::thread;

    use view::http::{REQUEST_BYTES_MAX, read};

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
        let serving = thread::spawn(move || {
            let mut server = server;
            let request = read(&mut server).unwrap();
            answer(server, request.as_ref(), &ask)
        });
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
        let (mut client, mut server) = UnixStream::pair().unwrap();
        client.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").unwrap();
        let request = read(&mut server).unwrap().unwrap();
        assert_eq!(route(&request, &ask).0, "503 Service Unavailable");
    }
}
