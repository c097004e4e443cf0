//! The new process of a stage that is being replaced.

use std::process::ExitStatus;
use std::time::Duration;

use recorder::ReplacementOutcome;
use wire::StageId;

use super::event::{Event, Replaced};
use super::member::Member;
use crate::child::{Child, Program, how_of};
use crate::control::Client;

/// A replacement in progress.
#[derive(Debug)]
pub struct Trial {
    pub(super) stage: StageId,
    pub(super) program: Program,
    /// The new process until it becomes the stage's process.
    pub(super) child: Option<Child>,
    /// The previous program.
    pub(super) before: Option<Program>,
    pub(super) incarnation: u32,
    /// When the new process was started or, later, took over.
    pub(super) started: Duration,
    pub(super) start_limit: Duration,
    pub(super) warm_up: Option<Duration>,
    pub(super) hand_over: Option<Duration>,
    pub(super) client: Client,
    /// The new process's connection, once it is warm.
    pub(super) turn: Option<Client>,
    /// Number of ticks and the time when the new process was ready.
    pub(super) ready: (u64, Duration),
}

impl Trial {
    /// Whether the new process has taken over as this stage.
    pub fn has_turn(&self, stage: StageId) -> bool {
        self.stage == stage && self.child.is_none()
    }

    pub(super) fn outcome(&self, outcome: ReplacementOutcome, incarnation: u32, cause: String) -> Replaced {
        Replaced {
            stage: self.stage,
            command: self.program.command.clone().unwrap_or_default(),
            outcome,
            incarnation,
            cause,
            warm_up: self.warm_up,
            hand_over: self.hand_over,
        }
    }

    /// Ends the replacement. The client gets the same outcome as the event.
    pub(super) fn conclude(mut self, outcome: ReplacementOutcome, incarnation: u32, cause: String) -> Event {
        let replaced = self.outcome(outcome, incarnation, cause);
        self.client.answer(outcome, replaced.to_string());
        Event::Tried(replaced)
    }

    /// Rolls back after the new process ended in its turn: the previous program is started again.
    pub fn roll_back(mut self, member: &mut Member, status: ExitStatus, now: Duration) -> Event {
        let cause = match member.killed_for {
            Some(why) => why.to_owned(),
            None => how_of(status),
        };
        member.program = self.before.take().unwrap_or_else(|| member.program.clone());
        member.supervision.rolled_back(now);
        let next = member.supervision.incarnation() + 1;
        self.conclude(ReplacementOutcome::RolledBack, next, cause)
    }
}
