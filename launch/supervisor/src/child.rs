#![expect(
    unsafe_code,
    reason = "a call between fork and exec: whatever the program is, it dies with the launcher"
)]

use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child as Process, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use crate::scheduling::Scheduling;
use ports::{
    COLOR_VARIABLE, Color, INCARNATION_VARIABLE, LAUNCHER_VARIABLE, RUN_VARIABLE, STANDBY_VARIABLE,
    TOPICS_VARIABLE,
};
use run::{Exit, Run, STAGE_VARIABLE};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open, set_parent_process_death_signal};
use wire::StageId;

use crate::error::{Error, StageDeath};
use crate::program::this_program;
use crate::scheduling;
use crate::spawn::spawn;
use crate::stage_output::{Output, StageOutput};

/// Interval between checks of an ending process.
const LOOK: Duration = Duration::from_millis(5);
/// Time that a killed process has to end. Most need a few milliseconds. A process in a system call that does not
/// end (state D) can't be killed, and the launcher does not wait for it.
pub const KILL_LIMIT: Duration = Duration::from_secs(1);
/// Time to wait for the last lines of a dead process, if another process holds its pipes open.
const LAST_LINES_LIMIT: Duration = Duration::from_millis(100);

/// The environment variable of glibc's settings.
const ALLOCATOR_VARIABLE: &str = "GLIBC_TUNABLES";
/// Keeps freed memory in the process and grows the heap by 1 MiB at a time. The next allocation then causes
/// no page fault.
const ALLOCATOR: &str =
    "glibc.malloc.trim_threshold=268435456:glibc.malloc.mmap_threshold=4194304:glibc.malloc.top_pad=1048576";

/// The signal raised when shared memory has no page left.
const BUS_ERROR: i32 = Signal::BUS.as_raw();

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

/// What all processes of a run share.
#[derive(Debug)]
pub struct Surroundings {
    /// The run.
    pub run: Run,
    /// The file of its record.
    pub record: PathBuf,
    /// The reader of the output.
    pub output: StageOutput,
    /// Further environment variables.
    pub environment: Vec<(String, String)>,
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
    output: Output,
    /// When it was first killed.
    killed: Option<Instant>,
    is_reported: bool,
}

/// Why a stage's process is not started.
#[derive(Debug)]
pub enum StartError {
    /// The start did not end in time: a file system does not answer.
    Hung(String),
    /// The program can't be started.
    Failed(Error),
}

impl From<StartError> for Error {
    fn from(error: StartError) -> Self {
        match error {
            StartError::Hung(text) => Self::unavailable(text),
            StartError::Failed(failure) => failure,
        }
    }
}

impl Child {
    /// Starts a stage, by its own command or by this program, and lets its output be read. If `standby` holds
    /// the launcher's socket, the process will replace one that is still running.
    pub fn start(
        stage: StageId,
        own: &Program,
        incarnation: u32,
        surroundings: &Surroundings,
        standby: Option<&Path>,
    ) -> Result<Self, StartError> {
        let Surroundings { run, record, output, environment } = surroundings;
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
            .envs(environment.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A separate process group, so Ctrl-C reaches only the launcher, which ends the stages in order.
            .process_group(0);
        if std::env::var_os(ALLOCATOR_VARIABLE).is_none() {
            command.env(ALLOCATOR_VARIABLE, ALLOCATOR);
        }
        die_with_this_process(&mut command);
        scheduling::set_at_start(&mut command, &own.scheduling);
        let mut process = spawn(command).map_err(|error| {
            let program = own.command.as_deref().and_then(<[String]>::first).map_or("stgdat", String::as_str);
            if error.kind() == ErrorKind::TimedOut {
                return StartError::Hung(format!("{program}: {error}"));
            }
            let about = format!("the {} can't be started: {program}", stage.name());
            StartError::Failed(Error::config_about(about, error))
        })?;
        let pipes = [process.stdout.take().map(OwnedFd::from), process.stderr.take().map(OwnedFd::from)];
        let descriptor = end_of(&process);
        match output.add(stage, pipes.into_iter().flatten()) {
            Ok(output) => {
                Ok(Self { stage, process, descriptor, ended: None, output, killed: None, is_reported: false })
            }
            Err(error) => {
                end_within(&mut process, Duration::ZERO);
                Err(StartError::Failed(Error::unavailable(error)))
            }
        }
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
            if signal == Signal::KILL {
                self.killed.get_or_insert_with(Instant::now);
            }
            // The process may end at this moment. Its process id stays reserved until it is reaped.
            let _ = kill_process(Pid::from_child(&self.process), signal);
        }
    }

    /// Whether the last lines of a dead process report a failed allocation.
    pub fn lacked_memory(&self) -> bool {
        let lines = self.output.last_lines(LAST_LINES_LIMIT);
        lines.iter().any(|line| {
            ["memory allocation of", "MemoryError", "bad_alloc"].iter().any(|of| line.contains(of))
        })
    }

    /// Whether the process was killed but does not end. Returns true once.
    pub fn cannot_die(&mut self) -> bool {
        let is_overdue = self.killed.is_some_and(|killed| killed.elapsed() > KILL_LIMIT);
        let is_new = is_overdue && !self.is_reported && self.ended().is_none();
        self.is_reported |= is_new;
        is_new
    }

    /// Describes the unrequested end of a child, with its last lines. Waits for these for at most 0.1 s.
    pub fn death(&self, status: ExitStatus) -> StageDeath {
        StageDeath {
            stage: self.stage,
            how: how_of(status),
            exit: status.code().and_then(Exit::from_code),
            last_lines: self.output.last_lines(LAST_LINES_LIMIT),
        }
    }
}

/// Describes the end of a process, phrased to follow its name.
pub fn how_of(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with exit code {code}"),
        (None, Some(BUS_ERROR)) => format!("was killed by signal {BUS_ERROR}: shared memory may be full"),
        (None, Some(signal)) => format!("was killed by signal {signal}"),
        (None, None) => status.to_string(),
    }
}

/// Returns a descriptor that is readable once a child has ended; `None` if the kernel has no pidfds.
pub fn end_of(process: &Process) -> Option<OwnedFd> {
    pidfd_open(Pid::from_child(process), PidfdFlags::empty()).ok()
}

/// Gives a process the time `limit` to end by itself, then kills it. Returns its exit status; `None` if it was
/// killed. A process that can't be killed is left behind.
pub fn end_within(process: &mut Process, limit: Duration) -> Option<ExitStatus> {
    let (begun, mut killed) = (Instant::now(), None::<Instant>);
    loop {
        match (process.try_wait(), killed) {
            (Ok(Some(status)), None) => return Some(status),
            (Ok(Some(_)), Some(_)) | (Err(_), _) => return None,
            (Ok(None), Some(at)) if at.elapsed() > KILL_LIMIT => return None,
            (Ok(None), None) if begun.elapsed() >= limit => {
                let _ = process.kill();
                killed = Some(Instant::now());
            }
            (Ok(None), _) => std::thread::sleep(LOOK),
        }
    }
}

/// Makes the kernel kill the program when the thread that starts it (see [`crate::spawn`]) ends.
pub fn die_with_this_process(command: &mut Command) {
    // SAFETY: between fork and exec the closure makes one system call and touches no memory of this process.
    unsafe {
        command.pre_exec(|| Ok(set_parent_process_death_signal(Some(Signal::KILL))?));
    }
}
