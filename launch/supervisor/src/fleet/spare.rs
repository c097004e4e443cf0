//! Warm spares: a second process of a stage, which has loaded and opened everything and waits for the first
//! one's death. The spare takes over once the dead process is cleaned up, so the start-up time is saved.
//!
//! A spare is started like a replacement process (`replace`), once the stage is linked, and has the stage's
//! next incarnation. Nothing depends on a spare, and its deaths are counted instead of reported one by one.
//! The stage's restart policy applies to the spare, too.

use std::time::Duration;

use crate::restart::RestartPolicy;
use recorder::SpareReport;
use run::Exit;
use rustix::process::Signal;

use crate::child::{Child, how_of};
use crate::control::Client;
use crate::policy::{End, State, Supervision};
use crate::processes::memory;

/// Interval between checks of a spare's memory.
const LOOK: Duration = Duration::from_secs(1);

/// The spare of a stage.
#[derive(Debug)]
pub struct Spare {
    /// When the next process is started.
    pub(super) supervision: Supervision,
    pub(super) child: Option<Child>,
    /// The spare's connection, once it is warm.
    pub(super) turn: Option<Client>,
    pub(super) incarnation: u32,
    pub(super) started: Duration,
    pub(super) looked: Duration,
    /// Number of the clean-up after the spare's last death.
    pub(super) ticket: u64,
    pub(super) report: SpareReport,
}

impl Spare {
    /// Creates the spare of a stage with this policy, without starting it.
    pub fn new(policy: RestartPolicy, now: Duration) -> Self {
        let mut supervision = Supervision::new(policy, now);
        supervision.rolled_back(now);
        Self {
            supervision,
            child: None,
            turn: None,
            incarnation: 0,
            started: now,
            looked: now,
            ticket: 0,
            report: SpareReport::default(),
        }
    }

    /// Returns the spare's state in one word.
    pub const fn state(&self) -> &'static str {
        match (&self.child, &self.turn, self.supervision.state()) {
            (Some(_), Some(_), _) => "ready",
            (Some(_), None, _) => "starting",
            (None, _, State::GivenUp { .. }) => "given up",
            (None, ..) => "waiting",
        }
    }

    /// Whether the spare is warming up. It then takes over sooner than a restarted process could.
    pub const fn is_starting(&self) -> bool {
        self.child.is_some() && self.turn.is_none()
    }

    /// Signals the spare to take over and returns its process; `None` if no spare is warm.
    pub fn take(&mut self, now: Duration) -> Option<Child> {
        let mut turn = self.turn.take()?;
        let child = self.child.take()?;
        self.supervision.rolled_back(now);
        // If the spare is gone, its end is handled like any other.
        let _ = turn.go();
        self.report.promotions += 1;
        Some(child)
    }

    /// Kills the spare's process, if there is one, and returns it.
    pub fn dismiss(&mut self, now: Duration) -> Option<Child> {
        self.turn = None;
        let mut child = self.child.take()?;
        child.signal(Signal::KILL);
        self.supervision.rolled_back(now);
        Some(child)
    }

    /// Handles the report of a warm process, if it comes from this spare.
    pub(super) fn ready(&mut self, incarnation: u32, client: Client, now: Duration) {
        if self.is_starting() && self.incarnation == incarnation {
            let warm_up = now.saturating_sub(self.started);
            self.report.warm_up_ms = Some((warm_up.as_secs_f64() * 1e4).round() / 1e1);
            (self.turn, self.looked) = (Some(client), self.started);
        }
    }

    /// Checks the spare's process. Returns whether it has ended and, if the spare is given up now, the
    /// reason.
    pub(super) fn tend(
        &mut self,
        has_files: impl FnOnce() -> bool,
        stopped: Duration,
        now: Duration,
    ) -> (bool, Option<String>) {
        self.started += stopped;
        let Some(child) = &mut self.child else { return (false, None) };
        let Some(status) = child.ended() else {
            if self.turn.is_none() {
                if now.saturating_sub(self.started) > self.supervision.policy().start_limit {
                    child.signal(Signal::KILL);
                }
            } else if now.saturating_sub(self.looked) > LOOK {
                self.looked = now;
                let [own, shared] = memory(child.pid()).unwrap_or_default();
                (self.report.memory_kib, self.report.shared_kib) = (own >> 10, shared >> 10);
            }
            return (false, None);
        };
        self.report.deaths += 1;
        let is_config = status.code() == Some(Exit::Config as i32) && has_files();
        let end = if is_config { End::Config } else { End::Failure };
        let how = match self.supervision.ended(end, now) {
            State::GivenUp { why } => Some(format!("its spare {} and is given up: {why}", how_of(status))),
            _ => None,
        };
        (self.child, self.turn) = (None, None);
        self.report.given_up.clone_from(&how);
        (true, how)
    }
}
