mod event;
mod member;
mod replace;
mod spare;
mod spares;
mod trial;

use std::collections::BTreeMap;
use std::os::fd::BorrowedFd;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use run::{OptionError, Run};
use rustix::process::{Pid, Signal};
use wire::{Heartbeat, StageId};

use crate::child::{Child, KILL_LIMIT, Program, StartError, Surroundings};
use crate::cleaner::Cleaner;
use crate::error::{Error, StageDeath};
use crate::health::Health;
use crate::policy::{End, State, Supervision};
use crate::readers::Readers;
use crate::restart::RestartPolicy;
use crate::scheduling;
use crate::stage_output::{Sink, StageOutput};
pub use event::{Event, Replaced};
use member::{Member, STOPPED};
use spare::Spare;
use trial::Trial;

/// Time that the stages have to end after a request to end.
const END_LIMIT: Duration = Duration::from_secs(3);
/// The same time limit if the retrieval memory must be written.
const MEMORY_LIMIT: Duration = Duration::from_secs(20);
/// Interval between checks of ending processes.
const LOOK: Duration = Duration::from_millis(5);
/// Time for the last output of the stages to be read.
const OUTPUT_LIMIT: Duration = Duration::from_millis(100);

/// The processes of a run; dropping it ends them all.
#[derive(Debug)]
pub struct Fleet {
    surroundings: Surroundings,
    check: CheckOptions,
    members: Vec<Member>,
    cleaner: Cleaner,
    /// Killed processes that no stage needs and that have not ended yet.
    dying: Vec<Child>,
    begun: Instant,
    tended: Duration,
    end_limit: Duration,
    has_ended: bool,
    /// Number of the clean-up after the last death of a process that is not a stage.
    other_ticket: u64,
    /// The stage that is being replaced.
    trial: Option<Trial>,
    /// Number of the clean-up after a rejected replacement process.
    swept: u64,
    readers: Readers,
}

/// The rules for one stage.
#[derive(Clone, Debug)]
pub struct StageSettings {
    /// The stage.
    pub stage: StageId,
    /// Its program.
    pub program: Program,
    /// When it is started again.
    pub restart: RestartPolicy,
    /// Whether a second process waits to take over.
    pub has_spare: bool,
}

/// Checks the options of a built-in stage. Other stages check their own.
pub type CheckOptions = fn(StageId, &toml::Table) -> Result<(), OptionError>;

/// The rules for a run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The stages, in the order in which they are started.
    pub stages: Vec<StageSettings>,
    /// The run.
    pub run: Run,
    /// The file of its record.
    pub record: PathBuf,
    /// Whether the retrieval memory is written at the end, so the stages get more time.
    pub keeps_memory: bool,
    /// Environment variables of all stages.
    pub environment: Vec<(String, String)>,
    /// Checks the options of orders.
    pub check: CheckOptions,
}

/// A stage's process as the supervisor sees it.
#[derive(Clone, Copy, Debug)]
pub struct Process {
    /// The stage.
    pub stage: StageId,
    /// `running`, `restarting`, `given up` or `ended`.
    pub state: &'static str,
    /// The process id while the stage runs.
    pub pid: Option<Pid>,
    /// Number of earlier starts.
    pub incarnation: u32,
}

impl Fleet {
    /// Starts all stages. `sink` receives their lines.
    ///
    /// # Errors
    /// [`Error`] if a program can't be started.
    pub fn start(settings: Settings, sink: Sink) -> Result<Self, Error> {
        let Settings { stages, run, record, keeps_memory, environment, check } = settings;
        let end_limit = if keeps_memory { MEMORY_LIMIT } else { END_LIMIT };
        let cleaner = Cleaner::new(record.clone(), run.prefix.clone());
        let readers = Readers::new(&run)?;
        let output = StageOutput::open(sink).map_err(Error::unavailable)?;
        let mut fleet = Self {
            surroundings: Surroundings { run, record, output, environment },
            check,
            members: Vec::new(),
            cleaner,
            dying: Vec::new(),
            begun: Instant::now(),
            tended: Duration::ZERO,
            end_limit,
            has_ended: false,
            other_ticket: 0,
            trial: None,
            swept: 0,
            readers,
        };
        for StageSettings { stage, program, restart, has_spare } in stages {
            let child = Child::start(stage, &program, 0, &fleet.surroundings, None)?;
            let now = fleet.begun.elapsed();
            let (supervision, health) = (Supervision::new(restart, now), Health::new(now));
            fleet.members.push(Member {
                stage,
                program,
                child,
                supervision,
                health,
                ticket: 0,
                killed_for: None,
                spare: has_spare.then(|| Spare::new(restart, now)),
            });
        }
        Ok(fleet)
    }

    /// Returns the settings of pipeline.toml that the running processes could not get.
    pub fn notes(&self) -> Vec<String> {
        scheduling::refused(self.members.iter().map(|m| (m.stage, m.child.pid(), &m.program.scheduling)))
    }

    /// Returns descriptors that become readable when a supervised process ends.
    pub fn descriptors(&self) -> Vec<BorrowedFd<'_>> {
        let runs = |member: &&Member| matches!(member.supervision.state(), State::Running { .. });
        let members = self.members.iter().filter(runs).map(|member| &member.child);
        let spares = self.members.iter().filter_map(|member| member.spare.as_ref()?.child.as_ref());
        let of_children = members.chain(spares).filter_map(Child::descriptor);
        of_children.chain(self.cleaner.descriptor()).collect()
    }

    /// Returns the numbers of lines that the stages printed too fast, by stage.
    pub fn lost_lines(&self) -> BTreeMap<StageId, u64> {
        self.surroundings.output.lost()
    }

    /// The processes of all stages.
    pub fn processes(&self) -> impl Iterator<Item = Process> {
        self.members.iter().map(|member| {
            let (state, runs) = match member.supervision.state() {
                State::Running { .. } => ("running", true),
                State::Waiting { .. } => ("restarting", false),
                State::GivenUp { .. } => ("given up", false),
                State::Done => ("ended", false),
            };
            let pid = runs.then(|| member.child.pid());
            Process { stage: member.stage, state, pid, incarnation: member.supervision.incarnation() }
        })
    }

    /// Whether a detector has ended before the run has begun.
    pub fn awaits_source(&self) -> bool {
        self.members.iter().any(|member| member.supervision.is_awaited())
    }

    /// Whether a stage has ended with success.
    pub fn done(&self, stage: StageId) -> bool {
        self.members.iter().any(|m| m.stage == stage && m.supervision.state() == State::Done)
    }

    /// Whether the run can produce nothing more: its source has ended and its recorder is given up.
    pub fn is_over(&self) -> bool {
        let given_up = |m: &Member| matches!(m.supervision.state(), State::GivenUp { .. });
        self.done(StageId::Source) && self.members.iter().any(|m| m.stage == StageId::Recorder && given_up(m))
    }

    /// Reaps, restarts and watches the stages. `is_linked` is true once the run has begun. Before that, a
    /// detector that fails is awaited, and a stage that is given up ends the run. In lockstep every death ends
    /// the run.
    /// `is_restoring` is true while removed files of the run are restored. A stage that could not read them then
    /// is started again.
    ///
    /// # Errors
    /// [`Error::Death`] if a stage has ended that the output depends on.
    pub fn tend(
        &mut self,
        heartbeats: &[Heartbeat],
        is_linked: bool,
        is_restoring: bool,
    ) -> Result<Vec<Event>, Error> {
        let now = self.begun.elapsed();
        let stopped = now.saturating_sub(self.tended);
        self.tended = now;
        self.note_own();
        let mut events: Vec<Event> =
            self.readers.look(&mut self.cleaner, now).into_iter().map(Event::ReaderDied).collect();
        let is_again = |m: &Member| {
            m.supervision.incarnation() > 0 || matches!(m.supervision.state(), State::Waiting { .. })
        };
        let one_died = self.members.iter().any(is_again);
        for member in &mut self.members {
            if stopped > STOPPED {
                member.supervision.forgive(stopped);
                member.health.forgive(now);
            }
            for heartbeat in heartbeats {
                if heartbeat.stage == member.stage.number()
                    && heartbeat.incarnation == member.supervision.incarnation()
                {
                    member.health.beat(now);
                    if heartbeat.linked == 1 {
                        member.supervision.linked();
                    }
                }
            }
            if is_linked {
                member.supervision.begun();
            }
            if !matches!(member.supervision.state(), State::Running { .. }) {
                continue;
            }
            if let Some(status) = member.child.ended() {
                let failed = |trial: &mut Trial| trial.has_turn(member.stage) && !member.is_done(status);
                if let Some(trial) = self.trial.take_if(failed) {
                    member.ticket = self.cleaner.ticket();
                    events.push(trial.roll_back(member, status, now));
                    continue;
                }
                member.ticket = self.cleaner.ticket();
                if !self.surroundings.run.lockstep {
                    // Start the clean-up immediately; the last output is read meanwhile.
                    self.cleaner.tend(member.ticket, now)?;
                }
                if self.surroundings.run.lockstep && !member.is_done(status) {
                    return Err(member.child.death(status).into());
                }
                events.extend(member.handle_exit(
                    status,
                    is_linked,
                    ports::is_full(&self.surroundings.run.root),
                    !is_restoring && self.surroundings.record.exists(),
                    now,
                )?);
            } else if is_linked && !self.surroundings.run.lockstep {
                events.extend(member.examine(now));
            } else if one_died && !self.surroundings.run.lockstep {
                member.free(now);
            }
        }
        events.extend(self.tend_trial(stopped, now));
        events.extend(self.tend_dying());
        events.extend(self.tend_spares(is_linked, is_restoring, stopped, now)?);
        events.extend(self.restart(is_linked, now)?);
        self.note_own();
        Ok(events)
    }

    /// Reaps the processes that no stage needs. Reports each process that can't be killed.
    fn tend_dying(&mut self) -> Vec<Event> {
        let before = self.dying.len();
        self.dying.retain_mut(|child| child.ended().is_none());
        if self.dying.len() < before {
            // They held places on the topics that they read.
            self.swept = self.cleaner.ticket();
        }
        let members = self.members.iter_mut().map(|member| &mut member.child);
        let undead = members.chain(&mut self.dying).filter_map(|child| {
            child.cannot_die().then(|| Event::CannotDie { stage: child.stage, pid: child.pid() })
        });
        undead.collect()
    }

    /// Registers the launcher's own processes, so that their deaths do not count as deaths of readers.
    fn note_own(&mut self) {
        let members = self.members.iter().map(|member| &member.child);
        let spares = self.members.iter().filter_map(|member| member.spare.as_ref()?.child.as_ref());
        let trial = self.trial.iter().filter_map(|trial| trial.child.as_ref());
        let children = members
            .chain(spares)
            .chain(trial)
            .chain(&self.dying)
            .map(|child| child.pid().as_raw_nonzero().get());
        let now = self.begun.elapsed();
        self.readers.own(children.map(i32::unsigned_abs).chain(self.cleaner.pid()), now);
    }

    /// Registers another process that the launcher has started.
    pub fn note_process(&mut self, pid: Option<u32>) {
        self.readers.own(pid, self.begun.elapsed());
    }

    /// Counts the dead processes that read topics and were not stages.
    pub const fn dead_readers(&self) -> u64 {
        self.readers.deaths()
    }

    /// Restarts the stages whose pause is over and whose dead predecessor is cleaned up.
    fn restart(&mut self, is_linked: bool, now: Duration) -> Result<Vec<Event>, Error> {
        let mut events = Vec::new();
        let waiting =
            |m: &&Member| matches!(m.supervision.state(), State::Waiting { .. } | State::GivenUp { .. });
        let wanted = self.members.iter().filter(waiting).map(|m| m.ticket).max().unwrap_or(0);
        let spares = self.members.iter().filter_map(|m| Some(m.spare.as_ref()?.ticket));
        let wanted = wanted.max(spares.max().unwrap_or(0));
        let others = self.other_ticket.max(self.swept).max(self.readers.wanted());
        self.cleaner.tend(wanted.max(others), now)?;
        events.extend(self.cleaner.hung().map(Event::CleanUpHung));
        for member in &mut self.members {
            if member.supervision.is_due(now) && self.cleaner.is_done(member.ticket) {
                if member.spare.as_ref().is_some_and(Spare::is_starting) {
                    continue;
                }
                if let Some(child) = member.spare.as_mut().and_then(|spare| spare.take(now)) {
                    member.take_place(child, now);
                    member.has_started();
                    events.push(Event::Promoted { stage: member.stage });
                    continue;
                }
                let incarnation = member.supervision.incarnation() + 1;
                let program = &member.program;
                match Child::start(member.stage, program, incarnation, &self.surroundings, None) {
                    Ok(child) => {
                        member.child = child;
                        member.supervision.restarted(now);
                        member.health = Health::new(now);
                        member.killed_for = None;
                        member.has_started();
                    }
                    // As if it had ended at once.
                    Err(StartError::Hung(how)) => {
                        member.supervision.restarted(now);
                        events.extend(member.handle_end(End::Failure, how, None, is_linked, now)?);
                    }
                    Err(StartError::Failed(failure)) => return Err(failure),
                }
            }
        }
        Ok(events)
    }

    /// Cleans up after a dead process of the run that is not a stage.
    pub fn clean_up(&mut self) {
        self.other_ticket = self.cleaner.ticket();
    }

    /// Asks all stages to end, waits, and kills those that miss the limit. Returns the processes that can't be
    /// killed. They end with the system call that they are in, and no process waits for them.
    pub fn end(&mut self) -> Vec<(StageId, Pid)> {
        self.has_ended = true;
        self.dying.extend(self.trial.take().and_then(|mut trial| trial.child.take()));
        self.dying.extend(self.members.iter_mut().filter_map(|member| member.spare.as_mut()?.child.take()));
        self.dying.iter_mut().for_each(|child| child.signal(Signal::KILL));
        for child in self.members.iter_mut().map(|member| &mut member.child) {
            child.signal(Signal::TERM);
            // A stopped process receives the request only when it continues.
            child.signal(Signal::CONT);
        }
        let start = Instant::now();
        let is_alive = |child: &mut Child| child.ended().is_none();
        while start.elapsed() < self.end_limit + KILL_LIMIT
            && (self.members.iter_mut().any(|member| is_alive(&mut member.child))
                || self.dying.iter_mut().any(is_alive))
        {
            if start.elapsed() > self.end_limit {
                self.members.iter_mut().for_each(|member| member.child.signal(Signal::KILL));
            }
            std::thread::sleep(LOOK);
        }
        self.surroundings.output.finish(OUTPUT_LIMIT);
        let children = self.members.iter_mut().map(|member| &mut member.child).chain(&mut self.dying);
        children.filter_map(|child| child.ended().is_none().then(|| (child.stage, child.pid()))).collect()
    }

    /// Describes the end of a stage that failed after a request to end.
    pub fn failure(&mut self, stage: StageId) -> Option<StageDeath> {
        let child = &mut self.members.iter_mut().find(|member| member.stage == stage)?.child;
        let status = child.ended().filter(|status| !status.success())?;
        Some(child.death(status))
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        if !self.has_ended {
            self.end();
        }
    }
}
