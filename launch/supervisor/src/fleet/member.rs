//! A stage with its process.

use std::os::unix::process::ExitStatusExt as _;
use std::process::ExitStatus;
use std::time::Duration;

use run::Exit;
use rustix::process::Signal;
use wire::StageId;

use super::event::Event;
use super::spare::Spare;
use crate::child::{Child, Program, how_of};
use crate::error::{Error, StageDeath};
use crate::health::{Finding, Health, look};
use crate::policy::{End, State, Supervision};
use crate::restart::Restart;

/// The launcher checks at least every 50 ms. After ten times that long without a check, the launcher itself
/// was stopped or starved, and it does not know what happened in between.
pub(super) const STOPPED: Duration = Duration::from_millis(500);

/// A stage with its process.
#[derive(Debug)]
pub(super) struct Member {
    pub(super) stage: StageId,
    pub(super) program: Program,
    pub(super) child: Child,
    pub(super) supervision: Supervision,
    pub(super) health: Health,
    /// Number of the clean-up after its last death.
    pub(super) ticket: u64,
    /// Why the launcher killed the process, if it did.
    pub(super) killed_for: Option<&'static str>,
    /// The spare that waits to take over.
    pub(super) spare: Option<Spare>,
}

impl Member {
    /// Whether the process has ended because its work is done.
    pub(super) fn is_done(&self, status: ExitStatus) -> bool {
        status.success() && matches!(self.stage, StageId::Source | StageId::Recorder)
    }

    /// Records the start of the process. An external program does not report linking, so it counts as linked.
    pub(super) fn has_started(&mut self) {
        if self.program.command.is_some() {
            self.supervision.linked();
        }
    }

    /// Whether this is a detector of others, whose device may not be ready when the run starts.
    pub(super) fn is_detector(&self) -> bool {
        self.stage == StageId::Source && self.program.command.is_some()
    }

    /// Records the end of the process. Before the run has begun (`is_linked`), a detector that fails is awaited,
    /// and a stage that is given up ends the run. `has_files` is false if files of the run were removed and may
    /// have been missing when the process read them.
    pub(super) fn handle_exit(
        &mut self,
        status: ExitStatus,
        is_linked: bool,
        is_full: bool,
        has_files: bool,
        now: Duration,
    ) -> Result<Option<Event>, Error> {
        let end = match status.code() {
            Some(0) if self.is_done(status) => End::Done,
            Some(0) => End::Success,
            Some(code) if code == Exit::Config as i32 && has_files => End::Config,
            _ if is_full => End::NoRoom,
            _ if !is_linked && self.is_detector() => End::NotReady,
            _ => End::Failure,
        };
        let ends_itself = status.signal().is_none_or(|signal| signal == Signal::ABORT.as_raw());
        let mut how = how_of(status);
        if let Some(mib) =
            self.program.scheduling.memory_mib.filter(|_| ends_itself && self.child.lacked_memory())
        {
            how += &format!(": its memory reached the limit, memory_mib = {mib}");
        }
        self.handle_end(end, how, Some(status), is_linked, now)
    }

    /// Records the end of the process, or a start that failed and has no `status`.
    pub(super) fn handle_end(
        &mut self,
        end: End,
        how: String,
        status: Option<ExitStatus>,
        is_linked: bool,
        now: Duration,
    ) -> Result<Option<Event>, Error> {
        let stage = self.stage;
        match self.supervision.ended(end, now) {
            State::Waiting { .. } if end == End::NotReady => {
                let how = status.map_or(how, |status| self.child.death(status).how_and_why());
                Ok(Some(Event::NotReady { stage, how }))
            }
            State::Waiting { .. } => {
                let mut how = self.killed_for.map_or(how, str::to_owned);
                if end == End::NoRoom {
                    how += ", without room in shared memory or for the run's folder";
                }
                Ok(Some(Event::Died { stage, how, next: self.supervision.incarnation() + 1 }))
            }
            // The output, or the start of the run, depends on this stage, so the run ends.
            State::GivenUp { why }
                if !is_linked || matches!(stage, StageId::Source | StageId::Tracker | StageId::Sampler) =>
            {
                let no_process = StageDeath { stage, how, exit: None, last_lines: Vec::new() };
                let mut death = status.map_or(no_process, |status| self.child.death(status));
                if is_linked || self.supervision.incarnation() > 0 {
                    death.how += &format!(" and is given up: {why}");
                }
                Err(death.into())
            }
            State::GivenUp { why } => Ok(Some(Event::GivenUp { stage, how, why })),
            State::Running { .. } | State::Done => Ok(None),
        }
    }

    /// Kills a silent process before the pipeline is linked, after another one has died. It may wait forever
    /// for files that the dead process left half made.
    pub(super) fn free(&mut self, now: Duration) {
        let sends_heartbeats = self.program.command.is_none();
        if sends_heartbeats && self.supervision.is_stuck(now) && self.health.is_silent(now) {
            self.killed_for.get_or_insert("was not linked within its start limit, and killed");
            self.child.signal(Signal::KILL);
        }
    }

    /// Checks a silent process. Kills it if it is stopped, hangs or missed its limit for linking; its end is
    /// then handled like any other.
    pub(super) fn examine(&mut self, now: Duration) -> Option<Event> {
        let policy = *self.supervision.policy();
        let finding = if self.supervision.is_overdue(now) {
            self.killed_for = Some("was not linked within its start limit, and killed");
            Finding::Hung
        } else if self.health.is_silent(now) {
            self.health.judge(look(self.child.pid())?, policy.hang_after, now)
        } else {
            Finding::Well
        };
        match finding {
            Finding::Well => None,
            Finding::Stopped | Finding::Hung if policy.restart == Restart::Never => None,
            Finding::Stopped | Finding::Hung => {
                let why = if finding == Finding::Stopped {
                    "was stopped, and killed"
                } else {
                    "hung, and was killed"
                };
                self.killed_for.get_or_insert(why);
                self.child.signal(Signal::KILL);
                None
            }
            Finding::Starved => Some(Event::Starved { stage: self.stage }),
        }
    }

    /// Adopts a warm process as the stage's own.
    pub(super) fn take_place(&mut self, child: Child, now: Duration) {
        self.child = child;
        self.supervision.replaced(now);
        self.health = Health::new(now);
        self.killed_for = None;
    }
}
