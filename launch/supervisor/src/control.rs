//! The launcher's socket in the run's folder: replacement orders and ready reports of new processes.
//!
//! A connection carries one line of text to the launcher, `replace {…}` or `ready STAGE INCARNATION`.
//! Processes of other users are refused.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use ports::is_own_user;
use recorder::ReplacementOutcome;
use run::Run;
use serde::{Deserialize, Serialize};
use wire::StageId;

use crate::error::Error;

/// Name of the socket in the run's folder.
const NAME: &str = "control";
/// Maximum number of waiting requests; further ones are answered with "busy".
const WAITING_MAX: usize = 8;
/// Longest line, in bytes: a command with its arguments.
const LINE_BYTES_MAX: usize = 1 << 16;
/// Time limit for a process to write its line. Other requests wait for this thread meanwhile.
const LINE_LIMIT: Duration = Duration::from_millis(500);

/// An order to replace a stage by another program during the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// The stage's name.
    pub stage: String,
    /// The new program with its arguments; empty for the built-in one.
    pub command: Vec<String>,
    /// Options that change, as TOML.
    pub options: toml::Table,
}

/// The launcher's answer to an order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The outcome; `None` if the order was refused.
    pub outcome: Option<ReplacementOutcome>,
    /// The outcome as a sentence.
    pub text: String,
}

/// A process at the other end of a connection.
#[derive(Debug)]
pub struct Client(UnixStream);

/// A request to the launcher.
#[derive(Debug)]
pub enum Request {
    /// To replace a stage.
    Replace(Order, Client),
    /// A new process is warm and waits to take over.
    Ready(StageId, u32, Client),
}

/// The launcher's end of the socket.
#[derive(Debug)]
pub struct Control {
    requests: Receiver<Request>,
}

/// Path of the socket of a run.
pub fn path(run: &Run) -> PathBuf {
    run.root.join(NAME)
}

impl Control {
    /// Opens the socket. A thread listens on it until this process ends.
    pub fn open(run: &Run) -> Result<Self, Error> {
        let path = path(run);
        let about = |error: std::io::Error| Error::unavailable_about(path.display(), error);
        let listener = UnixListener::bind(&path).map_err(about)?;
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).map_err(about)?;
        let (sender, requests) = sync_channel(WAITING_MAX);
        std::thread::spawn(move || {
            for connection in listener.incoming().filter_map(Result::ok) {
                attend(connection, &sender);
            }
        });
        Ok(Self { requests })
    }

    /// Returns the requests since the last call.
    pub fn requests(&self) -> impl Iterator<Item = Request> {
        self.requests.try_iter()
    }
}

/// Reads the line of a connection and forwards its request.
fn attend(connection: UnixStream, requests: &SyncSender<Request>) {
    if !is_own_user(&connection) {
        return;
    }
    let Ok(line) = line_of(&connection) else { return };
    // A client that does not read must not block the launcher. An answer fits into an empty socket.
    if connection.set_nonblocking(true).is_err() {
        return;
    }
    let mut client = Client(connection);
    let request = match parse(&line) {
        Some(Line::Replace(order)) => Request::Replace(order, client),
        Some(Line::Ready(stage, incarnation)) => Request::Ready(stage, incarnation, client),
        None => {
            return client.refuse("the request can't be read: launcher and program must be of one version");
        }
    };
    if let Err(TrySendError::Full(Request::Replace(_, mut client) | Request::Ready(_, _, mut client))) =
        requests.try_send(request)
    {
        client.refuse("the launcher is busy");
    }
}

/// Reads a line within [`LINE_LIMIT`].
fn line_of(mut connection: &UnixStream) -> std::io::Result<String> {
    let (begun, mut line, mut block) = (Instant::now(), Vec::new(), [0; 4096]);
    while !line.contains(&b'\n') && line.len() < LINE_BYTES_MAX {
        let left = LINE_LIMIT.saturating_sub(begun.elapsed()).max(Duration::from_millis(1));
        connection.set_read_timeout(Some(left))?;
        match connection.read(&mut block)? {
            0 => break,
            _ if begun.elapsed() > LINE_LIMIT => return Err(std::io::ErrorKind::TimedOut.into()),
            len => line.extend_from_slice(&block[..len]),
        }
    }
    let line = line.split(|&byte| byte == b'\n').next().unwrap_or_default();
    Ok(String::from_utf8_lossy(line).into_owned())
}

/// The result of reading a line.
#[derive(Debug, PartialEq)]
enum Line {
    Replace(Order),
    Ready(StageId, u32),
}

fn parse(line: &str) -> Option<Line> {
    let (verb, rest) = line.trim_end().split_once(' ')?;
    match verb {
        "replace" => serde_json::from_str(rest).ok().map(Line::Replace),
        "ready" => {
            let (stage, incarnation) = rest.split_once(' ')?;
            Some(Line::Ready(StageId::from_name(stage)?, incarnation.parse().ok()?))
        }
        _ => None,
    }
}

impl Client {
    /// Answers an order. The client may be gone already.
    pub fn answer(&mut self, outcome: ReplacementOutcome, text: String) {
        self.write(&Answer { outcome: Some(outcome), text });
    }

    /// Refuses an order.
    pub fn refuse(&mut self, text: &str) {
        self.write(&Answer { outcome: None, text: text.to_owned() });
    }

    fn write(&mut self, answer: &Answer) {
        // The answer contains nothing that JSON can't represent.
        let _ = writeln!(self.0, "{}", serde_json::to_string(answer).unwrap_or_default());
    }

    /// Signals a process to take over. Returns whether the process is still connected.
    pub fn go(&mut self) -> bool {
        writeln!(self.0, "{}", ports::GO).is_ok()
    }
}

/// Sends an order to the launcher of a run and waits for the answer.
///
/// # Errors
/// [`Error::Unavailable`] if the run has no socket or ends before it answers.
pub fn order(socket: &Path, order: &Order) -> Result<Answer, Error> {
    let about = |error: std::io::Error| Error::unavailable_about(socket.display(), error);
    let mut connection = UnixStream::connect(socket).map_err(about)?;
    let text = serde_json::to_string(order).map_err(Error::data)?;
    if text.len() + 16 > LINE_BYTES_MAX {
        return Err(Error::Usage(format!("the command has more than {LINE_BYTES_MAX} bytes")));
    }
    writeln!(connection, "replace {text}").map_err(about)?;
    let mut answer = String::new();
    BufReader::new(connection).read_line(&mut answer).map_err(about)?;
    if answer.is_empty() {
        return Err(Error::unavailable("the run ended before the stage was replaced"));
    }
    serde_json::from_str(&answer).map_err(Error::data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_nonsense_is_not() {
        let order = Order {
            stage: "encoder".to_owned(),
            command: vec!["./mine".to_owned(), "--fast".to_owned()],
            options: "workers = 2".parse().unwrap(),
        };
        let line = format!("replace {}\n", serde_json::to_string(&order).unwrap());
        assert_eq!(parse(&line), Some(Line::Replace(order)));
        assert_eq!(parse("ready decoder 3\n"), Some(Line::Ready(StageId::Decoder, 3)));
        for nonsense in
            ["", "ready", "ready decoder", "ready nobody 1", "ready decoder x", "replace {}", "end now"]
        {
            assert_eq!(parse(nonsense), None, "{nonsense:?}");
        }
    }

    #[test]
    fn an_order_reaches_the_launcher_and_is_answered() {
        let root = std::env::temp_dir().join(format!("stgdat-control-{}", std::process::id()));
        std::fs::create_dir_all(&root).unwrap();
        let run = Run { root: root.clone(), ..Run::default() };
        let control = Control::open(&run).unwrap();
        let given = Order { stage: "encoder".to_owned(), command: Vec::new(), options: toml::Table::new() };
        let answered = std::thread::scope(|scope| {
            let client = scope.spawn(|| order(&path(&run), &given).unwrap());
            let Ok(Request::Replace(order, mut client_end)) = control.requests.recv() else {
                panic!("no order")
            };
            assert_eq!(order, given);
            client_end.answer(ReplacementOutcome::NotUsed, "it ended".to_owned());
            client.join().unwrap()
        });
        assert_eq!(answered.outcome, Some(ReplacementOutcome::NotUsed));
        let garbage = UnixStream::connect(path(&run)).unwrap();
        writeln!(&garbage, "what?").unwrap();
        let mut refused = String::new();
        BufReader::new(garbage).read_line(&mut refused).unwrap();
        assert!(refused.contains("can't be read"), "{refused}");
        std::fs::remove_dir_all(root).unwrap();
    }
}
