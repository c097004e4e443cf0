//! The launcher's side of the tap: its process, and that of a recording that `stgdat run --record` starts.

use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child as Process, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use ports::monotonic_ns;
use recording::tap::SOCKET;
use recording::{Event, Happened, LogLine};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};

use crate::child::die_with_this_process;
use crate::failure::Failure;
use crate::tap::RingArguments;
use crate::tap::server::Told;

/// Pause before a tap that died is started again.
const PAUSE: Duration = Duration::from_secs(1);
/// Time that the tap has to open its socket, and a recording to attach.
const START_LIMIT: Duration = Duration::from_secs(10);
/// Time that the tap has to hand on what is last.
const END_LIMIT: Duration = Duration::from_secs(7);
/// Time that a recording has to write what is last: a disk may be slow.
const RECORDING_LIMIT: Duration = Duration::from_secs(20);
/// Bytes for a tap that does not read, beyond what the pipe holds; lines that have no room are left out.
const UNSENT_MAX: usize = 1 << 18;
/// Interval between looks at a process.
const LOOK: Duration = Duration::from_millis(5);

/// The tap's process, started again where it dies.
#[derive(Debug)]
pub struct Tap {
    record: PathBuf,
    socket: PathBuf,
    process: Option<Process>,
    input: Option<ChildStdin>,
    unsent: Vec<u8>,
    died: Option<Instant>,
}

impl Tap {
    /// Starts the tap of a run, and waits until tools can attach.
    pub fn start(record: &Path) -> Result<Self, Failure> {
        let socket = record.with_file_name(SOCKET);
        let (process, input, unsent, died) = (None, None, Vec::new(), None);
        let mut tap = Self { record: record.to_owned(), socket, process, input, unsent, died };
        tap.spawn()?;
        let begun = Instant::now();
        while !tap.socket.exists() {
            if begun.elapsed() > START_LIMIT || tap.has_ended() {
                return Err(Failure::Failed("the tap could not be started".to_owned()));
            }
            std::thread::sleep(LOOK);
        }
        Ok(tap)
    }

    fn spawn(&mut self) -> Result<(), Failure> {
        let mut command = Command::new(std::env::current_exe().map_err(Failure::unavailable)?);
        command.arg("tap").arg("--run").arg(&self.record);
        // A process group of its own: Ctrl-C reaches the launcher alone, which ends the tap last.
        command.stdin(Stdio::piped()).stdout(Stdio::null()).process_group(0);
        die_with_this_process(&mut command);
        let mut process = command.spawn().map_err(Failure::unavailable)?;
        if let Some(input) = process.stdin.take() {
            // A tap that is stopped must not stop the launcher.
            let flags = fcntl_getfl(input.as_fd()).map_err(Failure::unavailable)?;
            fcntl_setfl(input.as_fd(), flags | OFlags::NONBLOCK).map_err(Failure::unavailable)?;
            self.input = Some(input);
        }
        self.unsent.clear();
        (self.process, self.died) = (Some(process), None);
        Ok(())
    }

    fn has_ended(&mut self) -> bool {
        self.process.as_mut().is_none_or(|process| process.try_wait().unwrap_or(None).is_some())
    }

    /// Its process number, while it runs.
    pub fn pid(&self) -> Option<u32> {
        self.process.as_ref().map(Process::id)
    }

    /// Looks after the process; true where it has just died and its places on the topics are to be cleaned up.
    pub fn tend(&mut self) -> bool {
        if let Some(died) = self.died {
            // Tools go without where the system has no process for it; the run does not depend on it.
            if died.elapsed() >= PAUSE && self.spawn().is_err() {
                self.died = Some(Instant::now());
            }
            return false;
        }
        let has_died = self.has_ended();
        if has_died {
            (self.process, self.input, self.died) = (None, None, Some(Instant::now()));
        }
        has_died
    }

    /// Tells the tools what happened now.
    pub fn event(&mut self, what: Happened) {
        self.tell(&Told::Event(Event { at_ns: monotonic_ns(), what }));
    }

    /// Hands on a line of a stage.
    pub fn line(&mut self, stage: &str, line: &str) {
        let (at_ns, stage, line) = (monotonic_ns(), stage.to_owned(), line.to_owned());
        self.tell(&Told::Line(LogLine { at_ns, stage, line }));
    }

    fn tell(&mut self, told: &Told) {
        if let Ok(mut line) = serde_json::to_vec(told)
            && self.unsent.len() + line.len() < UNSENT_MAX
        {
            line.push(b'\n');
            self.unsent.extend(line);
        }
        self.send();
    }

    /// Writes what the pipe takes.
    fn send(&mut self) {
        let Some(input) = &mut self.input else { return self.unsent.clear() };
        while !self.unsent.is_empty() {
            match input.write(&self.unsent) {
                Ok(0) => return,
                Ok(len) => drop(self.unsent.drain(..len)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // Full: later. Closed: the process is found dead.
                Err(_) => return,
            }
        }
    }

    /// Lets the tools have what came last, and ends the process.
    pub fn end(&mut self) {
        self.send();
        // Its standard input ends.
        self.input = None;
        let begun = Instant::now();
        while !self.has_ended() {
            if begun.elapsed() > END_LIMIT
                && let Some(process) = &mut self.process
            {
                let _ = process.kill();
                let _ = process.wait();
            }
            std::thread::sleep(LOOK);
        }
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.end();
    }
}

/// A recording that the launcher has started beside the stages. It outlives a launcher that is killed for as long
/// as it takes to finish its file.
#[derive(Debug)]
pub struct Recording {
    process: Process,
    lines: Receiver<String>,
}

impl Recording {
    /// Starts `stgdat record` for a run, and waits until it gets every frame.
    pub fn start(root: &Path, file: &Path, topics: &str, ring: &RingArguments) -> Result<Self, Failure> {
        let mut command = Command::new(std::env::current_exe().map_err(Failure::unavailable)?);
        command.arg("record").arg(file).arg("--run").arg(root).args(["--topics", topics]);
        ring.pass_on(&mut command);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0);
        let mut process = command.spawn().map_err(Failure::unavailable)?;
        let lines = process.stdout.take().map(read).unwrap_or_else(|| channel().1);
        // The first line says that it is attached; without one it has said why on standard error.
        match lines.recv_timeout(START_LIMIT) {
            Ok(line) => {
                if ring.limits().is_some() {
                    note!("{line}");
                }
                Ok(Self { process, lines })
            }
            Err(_) => {
                let _ = process.kill();
                let _ = process.wait();
                Err(Failure::file(file, std::io::Error::other("the recording could not be begun")))
            }
        }
    }

    /// Waits until the file is finished, the tap being closed; returns what it says of it, and whether it is whole.
    pub fn end(mut self) -> (Vec<String>, bool) {
        let begun = Instant::now();
        let whole = loop {
            match self.process.try_wait() {
                Ok(Some(status)) => break status.success(),
                Ok(None) if begun.elapsed() < RECORDING_LIMIT => std::thread::sleep(LOOK),
                Ok(None) | Err(_) => {
                    let _ = self.process.kill();
                    let _ = self.process.wait();
                    break false;
                }
            }
        };
        (self.lines.iter().collect(), whole)
    }
}

/// The lines of a process, read beside the run so that its pipe never fills.
fn read(output: ChildStdout) -> Receiver<String> {
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    lines
}
