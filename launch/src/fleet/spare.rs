//! Warm spares: a second process of a stage, which has loaded and opened everything and waits for the first
//! one's death. The spare takes over once the dead process is cleaned up, so the start-up time is saved.
//!
//! A spare is started like a replacement process (`replace`), once the stage is linked, and has the stage's
//! next incarnation. Nothing depends on a spare, and its deaths are counted instead of reported one by one.
//! The stage's restart policy applies to the spare, too.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::config::RestartPolicy;
use recorder::SpareReport;
use run::{Exit, Run};
use rustix::process::Signal;
use wire::StageId;

use super::{Event, Fleet, Member};
use crate::child::Child;
use crate::control::{self, Client};
use crate::failure::Failure;
use crate::observe::memory_of;
use crate::policy::{End, State, Supervision};

/// Time from the start of a stage's process to the start of its spare: five ticks. The two processes then do
/// not compete for processors while the stage catches up.
const SETTLED: Duration = Duration::from_millis(400);
/// Interval between checks of a spare's memory.
const LOOK: Duration = Duration::from_secs(1);
/// Interval between checks of a killed process.
const PAUSE: Duration = Duration::from_millis(1);

/// The spare of a stage.
#[derive(Debug)]
pub struct Spare {
    /// When the next process is started.
    supervision: Supervision,
    child: Option<Child>,
    /// The spare's connection, once it is warm.
    turn: Option<Client>,
    incarnation: u32,
    started: Duration,
    looked: Duration,
    /// Number of the clean-up after the spare's last death.
    ticket: u64,
    report: SpareReport,
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

    /// Returns the number of the clean-up after the spare's last death.
    pub const fn ticket(&self) -> u64 {
        self.ticket
    }

    /// Returns the spare's process, if it has one.
    pub const fn child(&self) -> Option<&Child> {
        self.child.as_ref()
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

    /// Ends the spare's process. Returns whether there was one.
    pub fn dismiss(&mut self, now: Duration) -> bool {
        self.turn = None;
        let Some(mut child) = self.child.take() else { return false };
        child.signal(Signal::KILL);
        while child.ended().is_none() {
            std::thread::sleep(PAUSE);
        }
        self.supervision.rolled_back(now);
        true
    }

    /// Handles the report of a warm process, if it comes from this spare.
    fn ready(&mut self, incarnation: u32, client: Client, now: Duration) {
        if self.is_starting() && self.incarnation == incarnation {
            let warm_up = now.saturating_sub(self.started);
            self.report.warm_up_ms = Some((warm_up.as_secs_f64() * 1e4).round() / 1e1);
            (self.turn, self.looked) = (Some(client), self.started);
        }
    }

    /// Checks the spare's process. Returns whether it has ended and, if the spare is given up now, the
    /// reason.
    fn tend(&mut self, stopped: Duration, now: Duration) -> (bool, Option<String>) {
        self.started += stopped;
        let Some(child) = &mut self.child else { return (false, None) };
        let Some(status) = child.ended() else {
            if self.turn.is_none() {
                if now.saturating_sub(self.started) > self.supervision.policy().start_limit {
                    child.signal(Signal::KILL);
                }
            } else if now.saturating_sub(self.looked) > LOOK {
                self.looked = now;
                let [own, shared] = memory_of(child.pid()).unwrap_or_default();
                (self.report.memory_kib, self.report.shared_kib) = (own >> 10, shared >> 10);
            }
            return (false, None);
        };
        self.report.deaths += 1;
        let end = if status.code() == Some(Exit::Config as i32) { End::Config } else { End::Failure };
        let how = match self.supervision.ended(end, now) {
            State::GivenUp { why } => {
                Some(format!("its spare {} and is given up: {why}", child.death(status).how))
            }
            _ => None,
        };
        (self.child, self.turn) = (None, None);
        self.report.given_up.clone_from(&how);
        (true, how)
    }
}

impl Fleet {
    /// Returns each spare's state and the number of its takeovers.
    pub fn spares(&self) -> impl Iterator<Item = (StageId, &'static str, u32)> {
        let spares = self.members.iter().filter_map(|member| Some((member.stage, member.spare.as_ref()?)));
        spares.map(|(stage, spare)| (stage, spare.state(), spare.report.promotions))
    }

    /// Returns the outcome of each spare, for the report.
    pub fn spare_reports(&self) -> BTreeMap<String, SpareReport> {
        let spares = self.members.iter().filter_map(|member| Some((member, member.spare.as_ref()?)));
        let report = |spare: &Spare| SpareReport { state: spare.state().to_owned(), ..spare.report.clone() };
        spares.map(|(member, spare)| (member.stage.name().to_owned(), report(spare))).collect()
    }

    /// Handles the report of a warm process, which may be a spare.
    pub(super) fn spare_ready(&mut self, stage: StageId, incarnation: u32, client: Client, now: Duration) {
        let member = self.members.iter_mut().find(|member| member.stage == stage);
        if let Some(spare) = member.and_then(|member| member.spare.as_mut()) {
            spare.ready(incarnation, client, now);
        }
    }

    /// Checks the spares and starts those that are due.
    pub(super) fn tend_spares(
        &mut self,
        is_linked: bool,
        stopped: Duration,
        now: Duration,
    ) -> Result<Vec<Event>, Failure> {
        let mut events = Vec::new();
        if self.run.lockstep || !is_linked {
            return Ok(events);
        }
        let socket = control::path(&self.run);
        for member in &mut self.members {
            let is_tried = self.trial.as_ref().is_some_and(|trial| trial.stage() == member.stage);
            let state = member.supervision.state();
            let Some(spare) = &mut member.spare else { continue };
            let has_stage = matches!(state, State::Running { .. } | State::Waiting { .. });
            if is_tried || !has_stage {
                if spare.dismiss(now) {
                    spare.ticket = self.cleaner.ticket();
                }
                continue;
            }
            let stopped = if stopped > super::STOPPED { stopped } else { Duration::ZERO };
            let (has_ended, given_up) = spare.tend(stopped, now);
            if has_ended {
                spare.ticket = self.cleaner.ticket();
            }
            events.extend(given_up.map(|how| Event::SpareGivenUp { stage: member.stage, how }));
            let is_settled = matches!(state, State::Running { since, linked: true }
                if now.saturating_sub(since) > SETTLED);
            let is_due = spare.child.is_none() && spare.supervision.is_due(now);
            if is_settled && is_due && self.cleaner.is_done(spare.ticket) {
                member.start_spare(&self.run, &self.record, &self.sender, &socket, now)?;
            }
        }
        Ok(events)
    }
}

impl Member {
    fn start_spare(
        &mut self,
        run: &Run,
        record: &std::path::Path,
        lines: &std::sync::mpsc::Sender<crate::child::Line>,
        socket: &std::path::Path,
        now: Duration,
    ) -> Result<(), Failure> {
        let incarnation = self.supervision.incarnation() + 1;
        let child = Child::start(self.stage, &self.program, incarnation, run, record, lines, Some(socket))?;
        if let Some(spare) = &mut self.spare {
            spare.supervision.restarted(now);
            (spare.child, spare.incarnation, spare.started) = (Some(child), incarnation, now);
        }
        Ok(())
    }
}
