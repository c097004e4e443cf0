//! The processes of a fault run: the launcher, its stages, the follower and the injectors.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::sync::mpsc::SyncSender;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::checker::Line;
use console::failure::Failure;
use run::STAGE_VARIABLE;
use rustix::process::{Pid, Resource as Limited, Rlimit, Signal, kill_process, prlimit};
use supervisor::end_within;
use supervisor::look;
use supervisor::{children, memory};
use wire::StageId;

use crate::effect::Random;
use crate::program::this_program;
use crate::spec::Resource;

/// Time that a process has to end after a request.
const END_LIMIT: Duration = Duration::from_secs(3);
/// Interval between checks for the end of an output.
const LOOK: Duration = Duration::from_millis(1);

/// A process that writes history lines. When dropped, it is asked to end and then killed.
#[derive(Debug)]
pub struct Writer {
    child: Child,
    reader: Option<JoinHandle<()>>,
}

impl Writer {
    /// Starts `stgdat-lab fault …` and forwards its lines.
    pub fn start(arguments: &[&str], record: &Path, lines: &SyncSender<Line>) -> Result<Self, Failure> {
        let mut command = this_program();
        command.arg("fault").args(arguments).arg("--run").arg(record);
        let mut child = command.stdout(Stdio::piped()).spawn().map_err(Failure::unavailable)?;
        let (output, lines) = (child.stdout.take(), lines.clone());
        let reader = output.map(|output| {
            std::thread::spawn(move || {
                for text in BufReader::new(output).lines().map_while(Result::ok) {
                    // Lines that are not history are ignored. The process waits while the receiver is busy.
                    if let Ok(line) = serde_json::from_str(&text)
                        && lines.send(line).is_err()
                    {
                        return;
                    }
                }
            })
        });
        Ok(Self { child, reader })
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // Fails only if the process has already ended.
        let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
        end_within(&mut self.child, END_LIMIT);
        // Another process may hold the pipe open.
        let (begun, reader) = (Instant::now(), self.reader.take());
        while reader.as_ref().is_some_and(|reader| !reader.is_finished()) && begun.elapsed() < END_LIMIT {
            std::thread::sleep(LOOK);
        }
    }
}

/// A consumer that is repeatedly killed after a random time and restarted.
#[derive(Debug)]
pub struct Mortal {
    arguments: Vec<String>,
    record: PathBuf,
    within_ms: [u64; 2],
    random: Random,
    lines: SyncSender<Line>,
    writer: Writer,
    until: Instant,
    /// Number of times that it ended by itself, which happens if it can't read its topic.
    pub failures: u64,
}

impl Mortal {
    /// Starts `stgdat-lab fault …`, which is killed within these times after each start.
    pub fn start(
        arguments: Vec<String>,
        record: &Path,
        within_ms: [u64; 2],
        mut random: Random,
        lines: &SyncSender<Line>,
    ) -> Result<Self, Failure> {
        let (writer, until) = begin(&arguments, record, within_ms, &mut random, lines)?;
        let (record, lines) = (record.to_owned(), lines.clone());
        Ok(Self { arguments, record, within_ms, random, lines, writer, until, failures: 0 })
    }

    /// Kills the process when its time has come, and restarts it.
    pub fn tend(&mut self) -> Result<(), Failure> {
        let has_ended = !matches!(self.writer.child.try_wait(), Ok(None));
        if !has_ended && Instant::now() < self.until {
            return Ok(());
        }
        self.failures += u64::from(has_ended);
        end_within(&mut self.writer.child, Duration::ZERO);
        let Self { arguments, record, within_ms, random, lines, .. } = self;
        (self.writer, self.until) = begin(arguments, record, *within_ms, random, lines)?;
        Ok(())
    }
}

/// Starts a process that will be killed within these times.
fn begin(
    arguments: &[String],
    record: &Path,
    [shortest, longest]: [u64; 2],
    random: &mut Random,
    lines: &SyncSender<Line>,
) -> Result<(Writer, Instant), Failure> {
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let until = Instant::now() + Duration::from_millis(shortest + random.below(longest - shortest + 1));
    Ok((Writer::start(&arguments, record, lines)?, until))
}

/// The launcher, which is killed when this is dropped.
#[derive(Debug)]
pub struct Launcher(Child);

impl Launcher {
    /// Wraps a started process.
    pub const fn new(child: Child) -> Self {
        Self(child)
    }

    /// The process number.
    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.0)
    }

    /// Returns the exit status if the launcher has ended.
    pub fn ended(&mut self) -> Result<Option<ExitStatus>, Failure> {
        self.0.try_wait().map_err(Failure::unavailable)
    }

    /// The processes of its stages.
    pub fn stages(&self) -> Vec<(Pid, StageId)> {
        children(self.pid()).into_iter().filter_map(|pid| Some((pid, stage_of(pid)?))).collect()
    }

    /// The process of a stage.
    pub fn stage(&self, stage: StageId) -> Option<Pid> {
        self.stages().into_iter().find(|(_, of)| *of == stage).map(|(pid, _)| pid)
    }
}

impl Drop for Launcher {
    fn drop(&mut self) {
        end_within(&mut self.0, Duration::ZERO);
    }
}

/// Returns the stage of a process from its environment, which the launcher sets for every program.
fn stage_of(pid: Pid) -> Option<StageId> {
    let environment = std::fs::read(format!("/proc/{}/environ", pid.as_raw_nonzero())).ok()?;
    let prefix = format!("{STAGE_VARIABLE}=");
    let mut variables = environment.split(|byte| *byte == 0);
    let name = variables.find_map(|variable| variable.strip_prefix(prefix.as_bytes()))?;
    StageId::from_name(std::str::from_utf8(name).ok()?)
}

/// Resident memory of a process; 0 if it is gone.
pub fn resident_bytes(pid: Pid) -> u64 {
    memory(pid).map_or(0, |[own, shared]| own + shared)
}

/// Whether a process exists and is not a zombie.
pub fn is_alive(pid: Pid) -> bool {
    look(pid).is_some_and(|look| !matches!(look.state, b'Z' | b'X'))
}

/// Limits a resource of a process.
pub fn limit(pid: Pid, resource: Resource, value: u64) -> Result<(), Failure> {
    let resource = match resource {
        Resource::Descriptors => Limited::Nofile,
        Resource::FileSize => Limited::Fsize,
        Resource::Memory => Limited::As,
    };
    let limits = Rlimit { current: Some(value), maximum: Some(value) };
    prlimit(Some(pid), resource, limits).map_err(Failure::unavailable)?;
    Ok(())
}

/// Keeps the CPU busy with `threads` threads for `time`.
pub fn use_cpu(threads: usize, time: Duration) -> Vec<JoinHandle<()>> {
    let end = Instant::now() + time;
    let spin = move || {
        while Instant::now() < end {
            std::hint::spin_loop();
        }
    };
    (0..threads).map(|_| std::thread::spawn(spin)).collect()
}
