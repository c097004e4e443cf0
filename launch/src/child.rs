#![expect(
    unsafe_code,
    reason = "a call between fork and exec: whatever the program is, it dies with the launcher"
)]

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child as Process, Command, ExitStatus, Stdio};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::config::Scheduling;
use nn::kernels;
use ports::{
    COLOR_VARIABLE, Color, INCARNATION_VARIABLE, LAUNCHER_VARIABLE, RUN_VARIABLE, STANDBY_VARIABLE,
    TOPICS_VARIABLE,
};
use run::{Exit, Run, STAGE_VARIABLE};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open, set_parent_process_death_signal};
use wire::StageId;

use crate::failure::{Failure, StageDeath};
use crate::program::this_program;
use crate::{color, log, scheduling};

/// Number of output lines kept per stage, to be shown if the stage dies.
const LAST_LINES_MAX: usize = 12;
/// Maximum length of a line in bytes; longer lines are split.
const LINE_BYTES_MAX: u64 = 4096;

/// Interval between checks of an ending process.
const LOOK: Duration = Duration::from_millis(5);

/// The environment variable of glibc's settings.
const ALLOCATOR_VARIABLE: &str = "GLIBC_TUNABLES";
/// Keeps freed memory in the process and grows the heap by 1 MiB at a time. The next allocation then causes
/// no page fault.
const ALLOCATOR: &str =
    "glibc.malloc.trim_threshold=268435456:glibc.malloc.mmap_threshold=4194304:glibc.malloc.top_pad=1048576";

/// The signal raised when shared memory has no page left.
const BUS_ERROR: i32 = Signal::BUS.as_raw();

/// A line of a stage's output.
pub type Line = (StageId, String);

/// The program to start as a stage.
#[derive(Clone, Debug)]
pub struct Program {
    /// The program with its arguments; `None` for this program.
    pub command: Option<Vec<String>>,
    /// Topics that the program opens under another name, as `topic=name`.
    pub topics: Vec<String>,
    /// Processors and priority of the process.
    pub scheduling: Scheduling,
    /// A separate run record, if the options differ from the run's.
    pub record: Option<PathBuf>,
}

impl Program {
    /// Returns the program of a pipeline's stage.
    pub fn of(stage: &crate::config::Stage) -> Self {
        let topics = stage.topics.iter().map(|(topic, name)| format!("{topic}={name}")).collect();
        Self { command: stage.command.clone(), topics, scheduling: stage.scheduling.clone(), record: None }
    }
}

/// A stage's process.
#[derive(Debug)]
pub struct Child {
    /// The stage.
    pub stage: StageId,
    process: Process,
    /// Readable once the process has ended; `None` if the kernel is too old.
    descriptor: Option<OwnedFd>,
    ended: Option<ExitStatus>,
    last_lines: Arc<Mutex<VecDeque<String>>>,
    readers: Vec<JoinHandle<()>>,
}

impl Child {
    /// Starts a stage, by its own command or by this program, and sends its output through `lines`. If
    /// `standby` holds the launcher's socket, the process will replace one that is still running.
    pub fn start(
        stage: StageId,
        own: &Program,
        incarnation: u32,
        run: &Run,
        record: &Path,
        lines: &Sender<Line>,
        standby: Option<&Path>,
    ) -> Result<Self, Failure> {
        let record = own.record.as_deref().unwrap_or(record);
        let mut command = match own.command.as_deref() {
            Some([program, arguments @ ..]) => {
                let mut command = Command::new(program);
                command.args(arguments);
                command
            }
            _ => {
                let mut command = Command::new(this_program());
                command.args(["stage", stage.name(), "--run"]).arg(record);
                command
            }
        };
        command
            .env(RUN_VARIABLE, record)
            .env(LAUNCHER_VARIABLE, std::process::id().to_string())
            .env(INCARNATION_VARIABLE, incarnation.to_string())
            .env(STAGE_VARIABLE, stage.name())
            // The launcher colours the lines that it shows.
            .env(COLOR_VARIABLE, Color::Never.name())
            // For programs that write their timestamps without our library.
            .env("STGDAT_STAGE_NUMBER", stage.number().to_string())
            .env(TOPICS_VARIABLE, own.topics.join(","))
            .env("STGDAT_RUN_ID", run.id.to_string())
            .env("STGDAT_PREFIX", &run.prefix)
            .env("STGDAT_ROOT", &run.root)
            .env("STGDAT_INTERVAL_NS", run.interval_ns.to_string())
            .env("STGDAT_ORIGIN", run.origin().to_string())
            .env_remove(STANDBY_VARIABLE)
            .envs(standby.map(|socket| (STANDBY_VARIABLE, socket)))
            .envs(kernels::forced().map(|isa| (kernels::VARIABLE, isa.key())))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A separate process group, so Ctrl-C reaches only the launcher, which ends the stages in order.
            .process_group(0);
        log::pass_on(&mut command);
        if std::env::var_os(ALLOCATOR_VARIABLE).is_none() {
            command.env(ALLOCATOR_VARIABLE, ALLOCATOR);
        }
        die_with_this_process(&mut command);
        scheduling::set_at_start(&mut command, &own.scheduling);
        let mut process = command.spawn().map_err(|error| {
            let program = own.command.as_deref().and_then(<[String]>::first).map_or("stgdat", String::as_str);
            Failure::config_about(format!("the {} can't be started: {program}", stage.name()), error)
        })?;
        let last_lines = Arc::new(Mutex::new(VecDeque::new()));
        let outputs: [Option<Box<dyn Read + Send>>; 2] = [
            process.stdout.take().map(|pipe| Box::new(pipe) as _),
            process.stderr.take().map(|pipe| Box::new(pipe) as _),
        ];
        let readers = outputs
            .into_iter()
            .flatten()
            .map(|output| {
                let (kept, lines) = (last_lines.clone(), lines.clone());
                std::thread::spawn(move || read_lines(output, stage, &kept, &lines))
            })
            .collect();
        let descriptor = end_of(&process);
        Ok(Self { stage, process, descriptor, ended: None, last_lines, readers })
    }

    /// Readable once the process has ended; `None` if its end is already known.
    pub fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.descriptor.as_ref().filter(|_| self.ended.is_none()).map(AsFd::as_fd)
    }

    /// The process number.
    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.process)
    }

    /// Returns the exit status if the process has ended.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        if self.ended.is_none() {
            // Fails only for processes that are not children.
            self.ended = self.process.try_wait().unwrap_or(None);
        }
        self.ended
    }

    /// Sends a signal unless the process has ended.
    pub fn signal(&mut self, signal: Signal) {
        if self.ended().is_none() {
            // The process may end at this moment. Its process id stays reserved until it is reaped.
            let _ = kill_process(Pid::from_child(&self.process), signal);
        }
    }

    /// Describes the unrequested end of a child.
    pub fn death(&mut self, status: ExitStatus) -> StageDeath {
        // The pipes close with the process, so its output is soon complete. A grandchild may hold them open.
        let until = Instant::now() + Duration::from_millis(200);
        while !self.readers.iter().all(JoinHandle::is_finished) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
        let how = match (status.code(), status.signal()) {
            (Some(code), _) => format!("ended with exit code {code}"),
            (None, Some(BUS_ERROR)) => format!("was killed by signal {BUS_ERROR}: shared memory may be full"),
            (None, Some(signal)) => format!("was killed by signal {signal}"),
            (None, None) => status.to_string(),
        };
        let kept = self.last_lines.lock().unwrap_or_else(PoisonError::into_inner);
        StageDeath {
            stage: self.stage,
            how,
            exit: status.code().and_then(Exit::from_code),
            last_lines: kept.iter().cloned().collect(),
        }
    }
}

/// Returns a descriptor that is readable once a child has ended; `None` if the kernel has no pidfds.
pub fn end_of(process: &Process) -> Option<OwnedFd> {
    pidfd_open(Pid::from_child(process), PidfdFlags::empty()).ok()
}

/// Gives a process the time `limit` to end by itself, then kills it. Returns its exit status; `None` if it was
/// killed.
pub fn end_within(process: &mut Process, limit: Duration) -> Option<ExitStatus> {
    let begun = Instant::now();
    loop {
        match process.try_wait() {
            Ok(Some(status)) => return Some(status),
            Ok(None) if begun.elapsed() < limit => std::thread::sleep(LOOK),
            Ok(None) | Err(_) => {
                let _ = process.kill();
                let _ = process.wait();
                return None;
            }
        }
    }
}

/// Makes the kernel kill the program when the thread that starts it (the launcher's main thread) ends.
pub fn die_with_this_process(command: &mut Command) {
    // SAFETY: between fork and exec the closure makes one system call and touches no memory of this process.
    unsafe {
        command.pre_exec(|| Ok(set_parent_process_death_signal(Some(Signal::KILL))?));
    }
}

fn read_lines(output: impl Read, stage: StageId, kept: &Mutex<VecDeque<String>>, lines: &Sender<Line>) {
    let mut output = BufReader::new(output);
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        match (&mut output).take(LINE_BYTES_MAX).read_until(b'\n', &mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let line = color::plain(String::from_utf8_lossy(&bytes).trim_end()).into_owned();
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() == LAST_LINES_MAX {
            kept.pop_front();
        }
        kept.push_back(log::message(&line));
        // The receiver is gone once the run has ended.
        let _ = lines.send((stage, line));
    }
}
