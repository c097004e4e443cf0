//! Replaces a stage during the run. The new process is started and warmed while the old one runs, and takes
//! over between two ticks. If the new process fails before it takes over, nothing changes. If it fails
//! afterwards, the replacement is rolled back.

use std::time::{Duration, Instant};

use recorder::ReplacementOutcome;
use run::Run;
use rustix::process::Signal;
use wire::StageId;

use super::Fleet;
use super::event::Event;
use super::member::{Member, STOPPED};
use super::trial::Trial;
use crate::child::{Child, Program};
use crate::control::{self, Client, Order};
use crate::error::Error;
use crate::policy::State;

/// Time that the old process has to end, equal to the duration of the clean-up after a kill. Most processes
/// need less than 10 ms.
const END_LIMIT: Duration = Duration::from_millis(80);
/// Ticks between the ready report of a new process and its takeover. The new process may miss the first frame
/// that the old one sends after the new one has opened a topic.
const READY_TICKS: u64 = 2;
/// Maximum time between the two if no ticks arrive.
const READY_LIMIT: Duration = Duration::from_millis(400);
/// Maximum time for the hand-over, in which no other stage is supervised: the old process is asked to end, killed
/// and cleaned up.
const HAND_OVER_LIMIT: Duration = Duration::from_millis(500);
/// Interval between checks of an ending process.
const LOOK: Duration = Duration::from_millis(1);

impl Fleet {
    /// Starts the new process of an order, or refuses the order.
    pub fn replace(&mut self, order: &Order, mut client: Client, is_linked: bool) {
        match self.start_trial(order, is_linked) {
            Ok(started) => {
                let (stage, program, child, incarnation, start_limit) = started;
                self.trial = Some(Trial {
                    stage,
                    program,
                    child: Some(child),
                    before: None,
                    incarnation,
                    started: self.begun.elapsed(),
                    start_limit,
                    warm_up: None,
                    hand_over: None,
                    client,
                    turn: None,
                    ready: (0, Duration::ZERO),
                });
            }
            Err(why) => client.refuse(&why),
        }
    }

    /// Checks an order and starts its process. Returns the stage, program, process, incarnation and time
    /// limit for getting ready.
    fn start_trial(
        &self,
        order: &Order,
        is_linked: bool,
    ) -> Result<(StageId, Program, Child, u32, Duration), String> {
        let stage = StageId::from_name(&order.stage)
            .ok_or_else(|| format!("there is no stage \"{}\"", order.stage))?;
        let member = self.members.iter().find(|member| member.stage == stage);
        let member = member.ok_or_else(|| format!("the pipeline has no stage \"{}\"", order.stage))?;
        if self.surroundings.run.lockstep {
            return Err("a run in lockstep waits for every stage: replace them in real time".to_owned());
        }
        if !is_linked {
            return Err("the run has not begun: its stages are being linked".to_owned());
        }
        if let Some(trial) = &self.trial {
            return Err(format!("the {} is being replaced: one at a time", trial.stage.name()));
        }
        if !matches!(member.supervision.state(), State::Running { .. }) {
            return Err(format!("the {} does not run: there is nothing to take over from", stage.name()));
        }
        let incarnation = member.supervision.incarnation() + 1;
        // The stage's spare has the same incarnation and the old program. `tend_spares` ends it.
        let failed = |failure: Error| failure.to_string();
        let program = self.program(member, order, incarnation).map_err(failed)?;
        let socket = control::path(&self.surroundings.run);
        let child = Child::start(stage, &program, incarnation, &self.surroundings, Some(&socket))
            .map_err(|error| failed(error.into()))?;
        Ok((stage, program, child, incarnation, member.supervision.policy().start_limit))
    }

    /// Returns the program of an order. If both programs are built in, or neither is, the previous options
    /// are kept and the order's options are added. If the result differs from the run's options, the program
    /// gets a separate record.
    fn program(&self, member: &Member, order: &Order, incarnation: u32) -> Result<Program, Error> {
        let command = (!order.command.is_empty()).then(|| order.command.clone());
        let built_in = command.is_none();
        let (topics, scheduling) = (member.program.topics.clone(), member.program.scheduling.clone());
        let before = member.program.record.as_deref().unwrap_or(&self.surroundings.record);
        let mut run = Run::read(before).map_err(Error::config)?;
        let number = member.stage.number();
        let Some(own) = run.stages.iter_mut().find(|of| of.stage == number) else {
            return Ok(Program { command, topics, scheduling, record: None });
        };
        let mut options = toml::Table::new();
        if own.built_in == built_in {
            options = own.options.parse().map_err(Error::config)?;
        }
        options.extend(order.options.clone());
        if built_in {
            (self.check)(member.stage, &options)?;
        }
        let text = options.to_string();
        if own.built_in == built_in && own.options == text {
            return Ok(Program { command, topics, scheduling, record: member.program.record.clone() });
        }
        let set = order.options.keys().map(|key| (key.clone(), format!("--set {key}")));
        own.places.extend(set);
        (own.built_in, own.options) = (built_in, text);
        let record = self.surroundings.run.root.join(format!("run-{}-{incarnation}", member.stage.name()));
        run.write(&record).map_err(Error::config)?;
        Ok(Program { command, topics, scheduling, record: Some(record) })
    }

    /// Handles the ready report of a new process; `ticks` is the number of ticks so far.
    pub fn ready(&mut self, stage: StageId, incarnation: u32, client: Client, ticks: u64) {
        let now = self.begun.elapsed();
        if let Some(trial) = self.trial.as_mut().filter(|trial| trial.stage == stage)
            && trial.incarnation == incarnation
            && trial.turn.is_none()
        {
            trial.warm_up = Some(now.saturating_sub(trial.started));
            (trial.turn, trial.ready) = (Some(client), (ticks, now));
        } else {
            self.spare_ready(stage, incarnation, client, now);
        }
    }

    /// Whether a new process can take over after one more tick; `ticks` is the number of ticks so far.
    pub fn is_warm(&self, ticks: u64) -> bool {
        let now = self.begun.elapsed();
        self.trial.as_ref().is_some_and(|trial| {
            let (before, since) = trial.ready;
            let has_seen = ticks + 1 >= before + READY_TICKS || now.saturating_sub(since) > READY_LIMIT;
            trial.child.is_some() && trial.turn.is_some() && has_seen
        })
    }

    /// Ends the old process of the replaced stage and lets the new one take over.
    ///
    /// # Errors
    /// [`Error::Unavailable`] if the clean-up after a killed process can't be started.
    pub fn hand_over(&mut self) -> Result<Option<Event>, Error> {
        let Some(trial) = &mut self.trial else { return Ok(None) };
        let Some(member) = self.members.iter_mut().find(|member| member.stage == trial.stage) else {
            return Ok(None);
        };
        let begun = Instant::now();
        member.child.signal(Signal::TERM);
        member.child.signal(Signal::CONT);
        let status = loop {
            if let Some(status) = member.child.ended() {
                break status;
            }
            if begun.elapsed() > HAND_OVER_LIMIT {
                return Ok(self.reject("was not used: the old one does not end".to_owned()));
            }
            if begun.elapsed() > END_LIMIT {
                member.child.signal(Signal::KILL);
            }
            std::thread::sleep(LOOK);
        };
        // A process that ends by itself releases its places on the topics. After any other end a clean-up is
        // needed. If it takes too long, the new process waits for its places.
        if !status.success() {
            let ticket = self.cleaner.ticket();
            while !self.cleaner.is_done(ticket) && begun.elapsed() < HAND_OVER_LIMIT {
                self.cleaner.tend(ticket, self.begun.elapsed())?;
                std::thread::sleep(LOOK);
            }
            self.swept = ticket;
        }
        let Some(child) = trial.child.take() else { return Ok(None) };
        // If the new process is gone, its end is handled like any other.
        let _ = trial.turn.as_mut().map(Client::go);
        let now = self.begun.elapsed();
        (trial.hand_over, trial.started) = (Some(begun.elapsed()), now);
        trial.before = Some(std::mem::replace(&mut member.program, trial.program.clone()));
        member.take_place(child, now);
        Ok(Some(Event::HandedOver(trial.outcome(
            ReplacementOutcome::Replaced,
            trial.incarnation,
            String::new(),
        ))))
    }

    /// Marks a replacement as linked once the newest forecasts have passed its incarnation. `passed` returns
    /// the incarnation of a stage on the newest tick. External programs that send no heartbeats are found
    /// this way.
    pub fn passed(&mut self, passed: impl Fn(StageId) -> Option<u32>) {
        if let Some(trial) = &self.trial
            && trial.child.is_none()
            && passed(trial.stage) == Some(trial.incarnation)
            && let Some(member) = self.members.iter_mut().find(|member| member.stage == trial.stage)
        {
            member.supervision.linked();
        }
    }

    /// Checks a new process. It is rejected if it ends or is not warm in time, and it stays once it is
    /// linked.
    pub(super) fn tend_trial(&mut self, stopped: Duration, now: Duration) -> Option<Event> {
        let trial = self.trial.as_mut()?;
        if stopped > STOPPED {
            trial.started += stopped;
        }
        let member = self.members.iter_mut().find(|member| member.stage == trial.stage)?;
        let state = member.supervision.state();
        let is_overdue = now.saturating_sub(trial.started) > trial.start_limit;
        let cause = match &mut trial.child {
            None if matches!(state, State::Running { linked: true, .. } | State::Done) => {
                let (trial, incarnation) = (self.trial.take()?, member.supervision.incarnation());
                return Some(trial.conclude(ReplacementOutcome::Replaced, incarnation, String::new()));
            }
            None => {
                if is_overdue {
                    member.killed_for.get_or_insert("was not linked within its start limit, and killed");
                    member.child.signal(Signal::KILL);
                }
                return None;
            }
            Some(child) => match child.ended() {
                Some(status) => child.death(status).how_and_why(),
                None if !matches!(state, State::Running { .. }) => {
                    "was no longer needed: the old one died, and is restarted by its policy".to_owned()
                }
                None if trial.turn.is_none() && is_overdue => {
                    let seconds = trial.start_limit.as_secs();
                    format!("was not ready within its start limit of {seconds} s")
                }
                None => return None,
            },
        };
        self.reject(cause)
    }

    /// Ends a replacement whose new process is not used.
    fn reject(&mut self, cause: String) -> Option<Event> {
        let mut trial = self.trial.take()?;
        let member = self.members.iter().find(|member| member.stage == trial.stage)?;
        let incarnation = member.supervision.incarnation();
        if let Some(mut child) = trial.child.take() {
            child.signal(Signal::KILL);
            // It holds places on the topics that it reads until it is dead and cleaned up.
            self.dying.push(child);
        }
        Some(trial.conclude(ReplacementOutcome::NotUsed, incarnation, cause))
    }
}
