use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use console::failure::Failure;
use recorder::status::{RunStatus, STATUS_VERSION};

use crate::observe::SOCKET;

/// Time limit for the launcher to answer.
const LIMIT: Duration = Duration::from_secs(3);
/// Maximum size of an answer.
const ANSWER_BYTES_MAX: u64 = 16 << 20;

/// A client that asks a run's launcher.
#[derive(Debug)]
pub struct Client {
    socket: PathBuf,
}

impl Client {
    /// Creates the client of the run with this folder.
    pub fn new(root: &Path) -> Self {
        Self { socket: root.join(SOCKET) }
    }

    /// Whether the run still exists.
    pub fn is_there(&self) -> bool {
        self.socket.exists()
    }

    /// Returns the run's status.
    ///
    /// # Errors
    /// [`Failure::Unavailable`] if the launcher does not answer.
    pub fn ask(&self) -> Result<RunStatus, Failure> {
        let failed = |error| Failure::unavailable_about(self.socket.display(), error);
        let mut answer = Vec::new();
        self.exchange(&mut answer).map_err(failed)?;
        self.read(&answer)
    }

    fn exchange(&self, answer: &mut Vec<u8>) -> std::io::Result<()> {
        let mut stream = UnixStream::connect(&self.socket)?;
        stream.set_read_timeout(Some(LIMIT))?;
        stream.set_write_timeout(Some(LIMIT))?;
        stream.write_all(b"GET /status HTTP/1.0\r\n\r\n")?;
        stream.take(ANSWER_BYTES_MAX).read_to_end(answer).map(drop)
    }

    fn read(&self, answer: &[u8]) -> Result<RunStatus, Failure> {
        let failed = |what: String| Failure::unavailable_about(self.socket.display(), what);
        let text = std::str::from_utf8(answer).map_err(|error| failed(error.to_string()))?;
        let (head, body) = text.split_once("\r\n\r\n").ok_or_else(|| failed("no answer".to_owned()))?;
        if !head.starts_with("HTTP/1.1 200 ") {
            return Err(failed(body.trim_end().to_owned()));
        }
        // Only this number is read from a status of another version.
        #[derive(serde::Deserialize)]
        struct Versioned {
            version: u32,
        }
        let found =
            serde_json::from_str::<Versioned>(body).map_err(|error| failed(error.to_string()))?.version;
        if found != STATUS_VERSION {
            return Err(failed(format!(
                "a status of version {found}, this program reads {STATUS_VERSION}: launcher and top must be of \
                 one version"
            )));
        }
        serde_json::from_str(body).map_err(|error| failed(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_read_and_refusals_kept() {
        let client = Client::new(Path::new("/no/such/run"));
        assert!(client.ask().is_err() && !client.is_there());
        let error = |answer: &str| client.read(answer.as_bytes()).unwrap_err().to_string();
        assert!(error("HTTP/1.1 503 X\r\n\r\nbusy\n").ends_with("busy"));
        assert!(error("HTTP/1.1 200 OK\r\n\r\n{\"version\":99}").contains("version 99"));
        assert!(error("nonsense").ends_with("no answer"));
        let status = RunStatus { version: STATUS_VERSION, run: "a".to_owned(), ..RunStatus::default() };
        let answer = format!("HTTP/1.1 200 OK\r\n\r\n{}", serde_json::to_string(&status).unwrap());
        assert_eq!(client.read(answer.as_bytes()).unwrap(), status);
    }
}
