//! Cleans up after dead stages in a helper process, because a clean-up can block forever and the supervisor
//! must not.

use std::fmt;
use std::io::{ErrorKind, Read as _};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;
use std::process::{Child as Process, Command, Stdio};
use std::time::Duration;

use ports::{NodeNumber, NodeProcess};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};

use crate::child::{die_with_this_process, end_of};
use crate::error::Error;
use crate::program::this_program;
use crate::spawn::spawn;

/// Time limit of a helper. A clean-up takes 30 ms; even on a loaded machine it does not take a hundred times
/// as long. If a half-made connection blocks a helper, the helper is killed as soon as the connection is old
/// enough to be certainly abandoned.
const LIMIT: Duration = Duration::from_secs(2);
/// Number of timed-out helpers after which the stages start anyway. Each helper removes the file that blocked
/// the previous one.
const TRIES_MAX: u32 = 3;

/// Most killed helpers that may still run. No helper is started while there are so many.
const KILLED_MAX: usize = 8;

/// The clean-up of a run.
#[derive(Debug)]
pub struct Cleaner {
    record: PathBuf,
    prefix: String,
    work: Option<Work>,
    /// Killed helpers that have not ended yet.
    killed: Vec<Process>,
    tries: u32,
    /// Helpers that were killed since the last call of `hung`.
    hung: Vec<Hung>,
    /// Dead nodes that helpers have found since the last call of `met`.
    met: Vec<(NodeNumber, NodeProcess)>,
    /// Number of helpers that have ended, including those given up on. Files of a process that died before a
    /// helper began are cleaned.
    done: u64,
}

/// A helper that was killed.
#[derive(Clone, Copy, Debug)]
pub struct Hung {
    /// Time from its start until it was killed.
    pub after: Duration,
    /// Number of half-made connections that it removed.
    pub removed: usize,
}

impl fmt::Display for Hung {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a clean-up hung for {:.1} s", self.after.as_secs_f64())?;
        match self.removed {
            0 => Ok(()),
            removed => write!(f, "; half-made connections removed: {removed}"),
        }
    }
}

#[derive(Debug)]
struct Work {
    process: Process,
    descriptor: Option<OwnedFd>,
    since: Duration,
}

impl Cleaner {
    /// Creates the cleaner of the run with this record and prefix.
    pub fn new(record: PathBuf, prefix: String) -> Self {
        let (killed, hung, met) = (Vec::new(), Vec::new(), Vec::new());
        Self { record, prefix, work: None, killed, tries: 0, hung, met, done: 0 }
    }

    /// Returns the number of the clean-up that covers a death at this moment. A clean-up that is already
    /// running does not cover it.
    pub fn ticket(&self) -> u64 {
        self.done + 1 + u64::from(self.work.is_some())
    }

    /// Whether the clean-up with this number is over.
    pub const fn is_done(&self, ticket: u64) -> bool {
        self.done >= ticket
    }

    /// Returns the helper's process id while a helper runs.
    pub fn pid(&self) -> Option<u32> {
        self.work.as_ref().map(|work| work.process.id())
    }

    /// Readable once the helper has ended; `None` if none is running.
    pub fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        Some(self.work.as_ref()?.descriptor.as_ref()?.as_fd())
    }

    /// Helpers that were killed since the last call.
    pub fn hung(&mut self) -> impl Iterator<Item = Hung> {
        self.hung.drain(..)
    }

    /// Returns the dead nodes that helpers have cleaned, or tried to clean, since the last call.
    pub fn met(&mut self) -> Vec<(NodeNumber, NodeProcess)> {
        std::mem::take(&mut self.met)
    }

    /// Checks on the helper, and starts one if a clean-up up to number `wanted` is due.
    pub fn tend(&mut self, wanted: u64, now: Duration) -> Result<(), Error> {
        self.killed.retain_mut(|process| matches!(process.try_wait(), Ok(None)));
        if let Some(work) = &mut self.work {
            // Fails only for processes that are not children.
            if work.process.try_wait().unwrap_or(None).is_some() {
                self.met.extend(lines_of(&mut work.process));
                (self.work, self.tries, self.done) = (None, 0, self.done + 1);
                return self.start(wanted, now);
            }
            let after = now.saturating_sub(work.since);
            if after <= ports::HALF_MADE_LIMIT {
                return Ok(());
            }
            let removed = ports::remove_half_made_connections(&self.prefix, ports::HALF_MADE_LIMIT);
            if (removed > 0 || after > LIMIT)
                && let Some(mut work) = self.work.take()
            {
                let _ = work.process.kill();
                self.met.extend(lines_of(&mut work.process));
                self.killed.push(work.process);
                self.tries += 1;
                self.hung.push(Hung { after, removed });
                if self.tries == TRIES_MAX {
                    (self.tries, self.done) = (0, self.done + 1);
                }
            }
        }
        self.start(wanted, now)
    }

    /// Starts a helper if none is running and a clean-up up to number `wanted` is due.
    fn start(&mut self, wanted: u64, now: Duration) -> Result<(), Error> {
        if self.work.is_none() && self.done < wanted && self.killed.len() < KILLED_MAX {
            let mut command = Command::new(this_program());
            command.arg("sweep").arg("--run").arg(&self.record);
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
            die_with_this_process(&mut command);
            let process = match spawn(command) {
                // The next look tries again.
                Err(error) if error.kind() == ErrorKind::TimedOut => return Ok(()),
                started => started.map_err(Error::unavailable)?,
            };
            if let Some(output) = &process.stdout {
                // A helper that can't be killed must not block the launcher.
                let flags = fcntl_getfl(output).map_err(Error::unavailable)?;
                fcntl_setfl(output, flags | OFlags::NONBLOCK).map_err(Error::unavailable)?;
            }
            let descriptor = end_of(&process);
            self.work = Some(Work { process, descriptor, since: now });
        }
        Ok(())
    }
}

/// Formats the helper's output line about a dead node.
pub fn line(number: NodeNumber, process: &NodeProcess) -> String {
    let NodeProcess { name, program, pid } = process;
    format!("{number}\t{pid}\t{program}\t{name}")
}

/// Returns the dead nodes that a helper printed before it ended.
fn lines_of(helper: &mut Process) -> Vec<(NodeNumber, NodeProcess)> {
    let mut text = Vec::new();
    if let Some(output) = &mut helper.stdout {
        // The next look finds nodes that could not be read here.
        let _ = output.read_to_end(&mut text);
    }
    String::from_utf8_lossy(&text).lines().filter_map(read_line).collect()
}

fn read_line(line: &str) -> Option<(NodeNumber, NodeProcess)> {
    let mut fields = line.splitn(4, '\t');
    let number = fields.next()?.parse().ok()?;
    let pid = fields.next()?.parse().ok()?;
    let (program, name) = (fields.next()?.to_owned(), fields.next()?.to_owned());
    Some((number, NodeProcess { name, program, pid }))
}

impl Drop for Cleaner {
    fn drop(&mut self) {
        if let Some(work) = &mut self.work {
            let _ = work.process.kill();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_helper_is_read_as_it_was_written() {
        let process = NodeProcess { name: "my planner".to_owned(), program: "python3".to_owned(), pid: 4711 };
        assert_eq!(read_line(&line(1 << 100, &process)), Some((1 << 100, process)));
        assert_eq!(read_line("1\t2\tpyth"), None, "a helper that was killed");
    }
}
