//! The spares of a fleet's stages.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use recorder::SpareReport;
use wire::StageId;

use super::Fleet;
use super::event::Event;
use super::member::{Member, STOPPED};
use super::spare::Spare;
use crate::child::{Child, StartError, Surroundings};
use crate::control::{self, Client};
use crate::error::Error;
use crate::policy::{End, State};

/// Time from the start of a stage's process to the start of its spare: five ticks. The two processes then do
/// not compete for processors while the stage catches up.
const SETTLED: Duration = Duration::from_millis(400);

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
        is_restoring: bool,
        stopped: Duration,
        now: Duration,
    ) -> Result<Vec<Event>, Error> {
        let mut events = Vec::new();
        if self.surroundings.run.lockstep || !is_linked {
            return Ok(events);
        }
        let socket = control::path(&self.surroundings.run);
        for member in &mut self.members {
            let is_tried = self.trial.as_ref().is_some_and(|trial| trial.stage == member.stage);
            let state = member.supervision.state();
            let Some(spare) = &mut member.spare else { continue };
            let has_stage = matches!(state, State::Running { .. } | State::Waiting { .. });
            if is_tried || !has_stage {
                self.dying.extend(spare.dismiss(now));
                continue;
            }
            let stopped = if stopped > STOPPED { stopped } else { Duration::ZERO };
            let (has_ended, given_up) =
                spare.tend(|| !is_restoring && self.surroundings.record.exists(), stopped, now);
            if has_ended {
                spare.ticket = self.cleaner.ticket();
            }
            events.extend(given_up.map(|how| Event::SpareGivenUp { stage: member.stage, how }));
            let is_settled = matches!(state, State::Running { since, linked: true }
                if now.saturating_sub(since) > SETTLED);
            let is_due = spare.child.is_none() && spare.supervision.is_due(now);
            // A dismissed spare holds its places until it is dead and cleaned up.
            let is_clean = self.dying.is_empty() && self.cleaner.is_done(spare.ticket.max(self.swept));
            if is_settled && is_due && is_clean {
                member.start_spare(&self.surroundings, &socket, now)?;
            }
        }
        Ok(events)
    }
}

impl Member {
    fn start_spare(
        &mut self,
        surroundings: &Surroundings,
        socket: &Path,
        now: Duration,
    ) -> Result<(), Error> {
        let incarnation = self.supervision.incarnation() + 1;
        let started = Child::start(self.stage, &self.program, incarnation, surroundings, Some(socket));
        let child = match started {
            Ok(child) => child,
            Err(StartError::Failed(failure)) => return Err(failure),
            Err(StartError::Hung(_)) => {
                // As if it had ended at once.
                if let Some(spare) = &mut self.spare {
                    spare.report.deaths += 1;
                    spare.supervision.restarted(now);
                    spare.supervision.ended(End::Failure, now);
                }
                return Ok(());
            }
        };
        if let Some(spare) = &mut self.spare {
            spare.supervision.restarted(now);
            (spare.child, spare.incarnation, spare.started) = (Some(child), incarnation, now);
        }
        Ok(())
    }
}
