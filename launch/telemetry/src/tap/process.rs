//! The launcher's side of the tap. Manages the tap's process and the recording that `stgdat run --record`
//! starts.

use std::io::{BufRead as _, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child as Process, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use console::failure::Failure;
use console::log;
use ports::monotonic_ns;
use recording::tap::SOCKET;
use recording::{Event, Happened, LogLine};
use supervisor::{KILL_LIMIT, Origin, Outlet, die_with_this_process, end_within, spawn, this_program};
use wire::StageId;

use crate::tap::RingArguments;
use crate::tap::server::FromLauncher;

/// Pause before a dead tap is restarted.
const PAUSE: Duration = Duration::from_secs(1);
/// Time limit for the tap to open its socket, and for a recording to attach.
const START_LIMIT: Duration = Duration::from_secs(10);
/// Time limit for the tap to forward its last data.
const END_LIMIT: Duration = Duration::from_secs(7);
/// Time limit for a recording to write its last data to a slow disk.
const RECORDING_LIMIT: Duration = Duration::from_secs(20);
/// Most unsent bytes of each stage for a tap that does not read, in addition to the pipe's buffer. Further lines
/// are dropped.
const UNSENT_MAX: usize = 1 << 16;
/// Maximum number of lines that a recording has printed and the launcher has not shown.
const LINES_MAX: usize = 64;
/// Interval between checks of a process.
const LOOK: Duration = Duration::from_millis(5);

/// The tap's process, restarted if it dies.
#[derive(Debug)]
pub struct Tap {
    record: PathBuf,
    socket: PathBuf,
    process: Option<Process>,
    messages: TapMessages,
    died: Option<Instant>,
}

/// The way of messages to the tap's process. A tap that does not read delays nobody.
#[derive(Clone, Debug, Default)]
pub struct TapMessages(Arc<Mutex<Option<Outlet>>>);

impl TapMessages {
    /// Forwards an output line of a stage.
    pub fn line(&self, stage: StageId, line: &str) {
        let line = LogLine { at_ns: monotonic_ns(), stage: stage.name().to_owned(), line: line.to_owned() };
        self.send(Some(stage), &FromLauncher::Line(line));
    }

    fn send(&self, origin: Origin, message: &FromLauncher) {
        let outlet = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let (Some(outlet), Ok(mut line)) = (&*outlet, serde_json::to_vec(message)) {
            line.push(b'\n');
            outlet.push(origin, line);
        }
    }

    /// Sends further messages to this process. The previous one gets what waits for it, and then the end.
    fn send_to(&self, next: Option<Outlet>) {
        let mut outlet = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(before) = std::mem::replace(&mut *outlet, next) {
            before.close();
        }
    }
}

impl Tap {
    /// Starts the tap of a run, and waits until tools can attach.
    pub fn start(record: &Path) -> Result<Self, Failure> {
        let socket = record.with_file_name(SOCKET);
        let messages = TapMessages::default();
        let mut tap = Self { record: record.to_owned(), socket, process: None, messages, died: None };
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
        let mut command = Command::new(this_program());
        command.arg("tap").arg("--run").arg(&self.record);
        // A separate process group, so Ctrl-C reaches only the launcher, which ends the tap last.
        command.stdin(Stdio::piped()).stdout(Stdio::null()).process_group(0);
        die_with_this_process(log::pass_on(&mut command));
        let mut process = spawn(command).map_err(Failure::unavailable)?;
        let input = process.stdin.take().map(|input| Outlet::open("tap", UNSENT_MAX, input));
        self.messages.send_to(input.transpose().map_err(Failure::unavailable)?);
        (self.process, self.died) = (Some(process), None);
        Ok(())
    }

    /// Returns the way of messages from other threads.
    pub fn messages(&self) -> TapMessages {
        self.messages.clone()
    }

    fn has_ended(&mut self) -> bool {
        self.process.as_mut().is_none_or(|process| process.try_wait().unwrap_or(None).is_some())
    }

    /// Returns the process id while the process runs.
    pub fn pid(&self) -> Option<u32> {
        self.process.as_ref().map(Process::id)
    }

    /// Checks the process. Returns true if it has just died, so its places on the topics need a clean-up.
    pub fn tend(&mut self) -> bool {
        if let Some(died) = self.died {
            // If the process can't be started, tools must do without it. The run does not depend on the tap.
            if died.elapsed() >= PAUSE && self.spawn().is_err() {
                self.died = Some(Instant::now());
            }
            return false;
        }
        let has_died = self.has_ended();
        if has_died {
            self.messages.send_to(None);
            (self.process, self.died) = (None, Some(Instant::now()));
        }
        has_died
    }

    /// Reports an event to the tools.
    pub fn event(&self, what: Happened) {
        self.messages.send(None, &FromLauncher::Event(Event { at_ns: monotonic_ns(), what }));
    }

    /// Lets the tap send its last data to the tools, and ends the process.
    pub fn end(&mut self) {
        // Closes the tap's standard input after the last message.
        self.messages.send_to(None);
        if let Some(process) = &mut self.process {
            end_within(process, END_LIMIT);
        }
    }
}

impl Drop for Tap {
    fn drop(&mut self) {
        self.end();
    }
}

/// A recording process started by the launcher. If the launcher is killed, the process runs on until its file
/// is finished.
#[derive(Debug)]
pub struct Recording {
    process: Process,
    lines: Receiver<String>,
}

impl Recording {
    /// Starts `stgdat record` for a run and waits until it receives all frames. `pass_on` adds further arguments.
    pub fn start(
        root: &Path,
        file: &Path,
        topics: &str,
        ring: &RingArguments,
        pass_on: impl FnOnce(&mut Command),
    ) -> Result<Self, Failure> {
        let mut command = Command::new(this_program());
        command.arg("record").arg(file).arg("--run").arg(root).args(["--topics", topics]);
        ring.pass_on(&mut command);
        pass_on(&mut command);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).process_group(0);
        log::pass_on(&mut command);
        let mut process = spawn(command).map_err(Failure::unavailable)?;
        let lines = process.stdout.take().map(read).unwrap_or_else(|| sync_channel(0).1);
        // The first line reports that the recording is attached. Without a first line, standard error has the
        // reason.
        match lines.recv_timeout(START_LIMIT) {
            Ok(line) => {
                if ring.limits().is_some() {
                    tracing::info!("{line}");
                }
                Ok(Self { process, lines })
            }
            Err(_) => {
                end_within(&mut process, Duration::ZERO);
                Err(Failure::file(file, std::io::Error::other("the recording could not be begun")))
            }
        }
    }

    /// Waits until the file is finished after the tap has closed. Returns the recording's last lines and
    /// whether the file is complete.
    pub fn end(mut self) -> (Vec<String>, bool) {
        let status = end_within(&mut self.process, RECORDING_LIMIT);
        let whole = status.is_some_and(|status| status.success());
        // Another process may hold the pipe open.
        (std::iter::from_fn(|| self.lines.recv_timeout(KILL_LIMIT).ok()).collect(), whole)
    }
}

/// Reads the lines of a process in the background, so its pipe never fills.
fn read(output: ChildStdout) -> Receiver<String> {
    let (sender, lines) = sync_channel(LINES_MAX);
    std::thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            // Further lines have no room.
            let _ = sender.try_send(line);
        }
    });
    lines
}
