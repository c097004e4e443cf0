//! Warm spares: a second process of a stage that has loaded and opened all that it needs, and waits for the first
//! one's death. It takes its place once what the dead one held is cleaned up: what a start takes is spared.
//!
//! A spare is started like a process that replaces another one (`replace`), once the stage is linked, and has the
//! stage's next incarnation. It is no stage: nobody waits for it, and its own deaths are counted, not reported one by
//! one. The stage's policy of restarts holds for it, too.

use std::collections::BTreeMap;
use std::time::Duration;

use config::RestartPolicy;
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

/// Time from the start of a stage's process to that of its spare, so that the two do not share the processors while
/// the stage catches up: five ticks.
const SETTLED: Duration = Duration::from_millis(400);
/// Time between two looks at a spare's memory.
const LOOK: Duration = Duration::from_secs(1);
/// Interval between looks at a process that was killed.
const PAUSE: Duration = Duration::from_millis(1);

/// The spare of a stage.
#[derive(Debug)]
pub struct Spare {
    /// When the next process is started.
    supervision: Supervision,
    child: Option<Child>,
    /// Its end of the socket, once it is warm.
    turn: Option<Client>,
    incarnation: u32,
    started: Duration,
    looked: Duration,
    /// Number of the clean-up after its last death.
    ticket: u64,
    report: SpareReport,
}

impl Spare {
    /// That of a stage with this policy, not started yet.
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

    /// What it is doing, in a word.
    pub const fn state(&self) -> &'static str {
        match (&self.child, &self.turn, self.supervision.state()) {
            (Some(_), Some(_), _) => "ready",
            (Some(_), None, _) => "starting",
            (None, _, State::GivenUp { .. }) => "given up",
            (None, ..) => "waiting",
        }
    }

    /// Number of the clean-up after its last death.
    pub const fn ticket(&self) -> u64 {
        self.ticket
    }

    /// Its process, while it has one.
    pub const fn child(&self) -> Option<&Child> {
        self.child.as_ref()
    }

    /// Whether its process is being warmed: the stage is started again sooner by it than anew.
    pub const fn is_starting(&self) -> bool {
        self.child.is_some() && self.turn.is_none()
    }

    /// Its process, which is told that its turn has come; none where there is none that is warm.
    pub fn take(&mut self, now: Duration) -> Option<Child> {
        let mut turn = self.turn.take()?;
        let child = self.child.take()?;
        self.supervision.rolled_back(now);
        // Where it is gone, its end is found like any other.
        let _ = turn.go();
        self.report.promotions += 1;
        Some(child)
    }

    /// Ends its process, if it has one; whether it had.
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

    /// A process has said that it is warm; whether it is this one.
    fn ready(&mut self, incarnation: u32, client: Client, now: Duration) {
        if self.is_starting() && self.incarnation == incarnation {
            let warm_up = now.saturating_sub(self.started);
            self.report.warm_up_ms = Some((warm_up.as_secs_f64() * 1e4).round() / 1e1);
            (self.turn, self.looked) = (Some(client), self.started);
        }
    }

    /// Looks after its process; the reason where it is given up now, with whether it has ended.
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
    /// What the spares are doing: each with its state and how often it took the stage's place.
    pub fn spares(&self) -> impl Iterator<Item = (StageId, &'static str, u32)> {
        let spares = self.members.iter().filter_map(|member| Some((member.stage, member.spare.as_ref()?)));
        spares.map(|(stage, spare)| (stage, spare.state(), spare.report.promotions))
    }

    /// What became of the spares, for the report.
    pub fn spare_reports(&self) -> BTreeMap<String, SpareReport> {
        let spares = self.members.iter().filter_map(|member| Some((member, member.spare.as_ref()?)));
        let report = |spare: &Spare| SpareReport { state: spare.state().to_owned(), ..spare.report.clone() };
        spares.map(|(member, spare)| (member.stage.name().to_owned(), report(spare))).collect()
    }

    /// A spare may have said that it is warm.
    pub(super) fn spare_ready(&mut self, stage: StageId, incarnation: u32, client: Client, now: Duration) {
        let member = self.members.iter_mut().find(|member| member.stage == stage);
        if let Some(spare) = member.and_then(|member| member.spare.as_mut()) {
            spare.ready(incarnation, client, now);
        }
    }

    /// Looks after the spares, and starts those that are due.
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
