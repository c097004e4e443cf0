//! The process that times ONNX Runtime and PyTorch, and the environment that it needs.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use console::failure::Failure;

/// The script, which makes the environment and answers requests.
const SCRIPT: &str = include_str!("peers.py");

/// A running script, which ends when this is dropped.
pub(super) struct Python {
    process: Child,
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl Python {
    /// Starts the script with this interpreter, or with the interpreter of an environment that it makes
    /// first. Returns the versions of the libraries.
    ///
    /// # Errors
    /// Why the script can't start. The comparison then continues without it.
    pub fn start(interpreter: Option<PathBuf>) -> Result<(Self, String), String> {
        let interpreter = match interpreter {
            Some(interpreter) => interpreter,
            None => environment(&cache().ok_or("neither XDG_CACHE_HOME nor HOME is set")?)?,
        };
        let about = |error: std::io::Error| format!("{}: {error}", interpreter.display());
        let mut process = Command::new(&interpreter)
            .args(["-c", SCRIPT, "serve"])
            .env("OMP_NUM_THREADS", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(about)?;
        let requests = process.stdin.take();
        let answers = process.stdout.take().ok_or("no pipe")?;
        let mut python = Self { process, requests, answers: BufReader::new(answers) };
        let versions = python.line().map_err(about)?;
        Ok((python, versions))
    }

    /// The duration of a layer's fastest call within `time`; `None` if the library is missing.
    pub fn best_ms(&mut self, library: &str, layer: &str, time: Duration) -> Result<Option<f64>, Failure> {
        let broken = |error: std::io::Error| Failure::unavailable_about(format!("{library}, {layer}"), error);
        let requests = self.requests.as_mut().ok_or_else(|| Failure::unavailable("no pipe to the script"))?;
        writeln!(requests, "{library} {layer} {}", time.as_secs_f64()).map_err(broken)?;
        let answer = self.line().map_err(broken)?;
        if answer == "none" {
            return Ok(None);
        }
        let seconds: f64 = answer.parse().map_err(|_| broken(std::io::Error::other(answer.clone())))?;
        Ok(Some(seconds * 1e3))
    }

    fn line(&mut self) -> std::io::Result<String> {
        let mut line = String::new();
        match self.answers.read_line(&mut line)? {
            0 => Err(std::io::Error::other("the script has ended")),
            _ => Ok(line.trim().to_owned()),
        }
    }
}

impl Drop for Python {
    fn drop(&mut self) {
        // The script ends when its input is closed.
        self.requests = None;
        let _ = self.process.wait();
    }
}

/// The folder of the environment.
fn cache() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).filter(|path| !path.is_empty()).map(PathBuf::from);
    let folder = set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache")))?;
    Some(folder.join("stgdat").join("peers"))
}

/// Makes the environment unless it exists. Returns its interpreter.
fn environment(folder: &Path) -> Result<PathBuf, String> {
    if !folder.join("complete").exists() {
        let _ = writeln!(
            std::io::stderr(),
            "making a Python environment with ONNX Runtime and PyTorch in {}: once, up to 7 GB",
            folder.display()
        );
    }
    let output = Command::new("python3")
        .args(["-c", SCRIPT, "environment"])
        .arg(folder)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("python3: {error}"))?;
    if !output.status.success() {
        return Err(format!("the Python environment could not be made ({})", output.status));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let interpreter = text.lines().last().unwrap_or_default().trim();
    if interpreter.is_empty() { Err("python3 named no interpreter".into()) } else { Ok(interpreter.into()) }
}
