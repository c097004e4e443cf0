//! A run as its launcher follows it: linked stages, progress, outages, and the table or lines about them.

use std::time::{Duration, Instant};

use console::failure::Failure;
use console::log;
use console::terminal::{self, Table};
use ports::{Node, Peers, SideOutputs, Subscriber};
use recorder::status::RunStatus;
use run::Run;
use rustix::process::Pid;
use supervisor::{Event, Fleet};
use wire::{ForecastsTopic, Header, Heartbeat, HeartbeatsTopic, StageId, Topic};

use crate::observe::Observer;
use crate::outages::Outages;
use crate::top::{SortBy, View};

/// Longest sleep.
const SLEEP: Duration = Duration::from_millis(50);
/// Interval between updates of the table.
const UPDATE: Duration = Duration::from_millis(200);
/// Interval between lines if the output is not a terminal.
const LINE: Duration = Duration::from_secs(1);
/// Maximum number of rows of the table.
const ROWS: usize = 25;

/// Follows a run from the launcher: the linked stages and the run's progress.
pub struct Watch {
    forecasts: Subscriber<ForecastsTopic>,
    peers: Peers,
    side_outputs: SideOutputs,
    display: Display,
    shown: Instant,
    printed_ticks: u64,
    outages: Outages,
    observer: Observer,
    /// Header of the newest forecasts.
    newest: Option<Header>,
}

/// How the progress is shown.
#[derive(Debug)]
enum Display {
    /// A table at the bottom of the terminal. The lines of the log go above it.
    Table(Table),
    /// A line per second in the log.
    Lines,
    /// No display.
    Quiet,
}

impl Watch {
    /// Joins a run as a subscriber.
    pub fn open(run: &Run, quiet: bool, observer: Observer) -> Result<Self, Failure> {
        let node = Node::open(run, "launcher")?;
        Ok(Self {
            forecasts: node.subscriber(ForecastsTopic::DEPTH_MAX)?,
            side_outputs: SideOutputs::open(&node, run)?,
            peers: Peers::new(node.subscriber(HeartbeatsTopic::DEPTH_MAX)?, run),
            display: if quiet { Display::Quiet } else { Display::for_output() },
            shown: Instant::now(),
            printed_ticks: 0,
            outages: Outages::default(),
            observer,
            newest: None,
        })
    }

    /// Returns the stages that are not linked to their neighbours yet.
    pub fn unlinked(&self) -> Vec<StageId> {
        self.peers.unlinked()
    }

    /// Sleeps until a heartbeat, the end of a process, or half an update interval. Then shows the received
    /// data.
    pub fn follow(&mut self, fleet: &Fleet) -> Result<Vec<Heartbeat>, Failure> {
        self.peers.heartbeats().sleep_or(&fleet.descriptors(), SLEEP)?;
        let heartbeats = self.peers.listen()?;
        heartbeats.iter().for_each(|heartbeat| self.observer.heartbeat(heartbeat));
        self.take_forecasts()?;
        self.observer.check_input();
        self.count_lost_lines(fleet);
        self.show(fleet);
        Ok(heartbeats)
    }

    /// Counts the discarded lines of the log. The first loss of each origin is an event.
    fn count_lost_lines(&mut self, fleet: &Fleet) {
        let mut lost = log::lost();
        for (stage, lines) in fleet.lost_lines() {
            *lost.entry(Some(stage)).or_default() += lines;
        }
        for origin in self.outages.lost_lines(lost) {
            let whose = origin.map_or("launcher", StageId::name);
            self.observer
                .report(format!("lines of the {whose} are missing in the log: too many, or nobody reads"));
        }
    }

    /// Answers questions of tools about the run.
    pub fn answer(&mut self, fleet: &Fleet, is_linked: bool) {
        self.observer.answer(fleet, &self.outages, is_linked);
    }

    fn take_forecasts(&mut self) -> Result<(), Failure> {
        while let Some(frame) = self.forecasts.receive()? {
            if let Some(tick) = self.observer.forecasts(frame.header(), &frame) {
                self.outages.tick(frame.header(), &tick);
            }
            self.newest = Some(*frame.header());
            ports::log_tick(frame.header().seq);
        }
        self.side_outputs.take()?.iter().for_each(|header| self.observer.side_output(header));
        Ok(())
    }

    /// Returns the number of ticks whose forecasts have arrived.
    pub const fn ticks(&self) -> u64 {
        self.observer.ticks()
    }

    /// Sleeps until the forecasts of another tick have arrived, but at most `limit`. At that moment most
    /// stages wait for the next tick.
    pub fn await_tick(&mut self, limit: Duration) -> Result<(), Failure> {
        self.take_forecasts()?;
        let (begun, before) = (Instant::now(), self.ticks());
        while self.ticks() == before && begun.elapsed() < limit {
            self.forecasts.sleep(limit.saturating_sub(begun.elapsed()))?;
            self.take_forecasts()?;
        }
        Ok(())
    }

    /// Returns the incarnation of a stage that the newest tick has passed.
    pub fn passed(&self, stage: StageId) -> Option<u32> {
        self.newest.as_ref()?.hop(stage).map(|hop| hop.incarnation)
    }

    /// Logs an event of the launcher and keeps it for the report.
    pub fn say(&mut self, event: &Event) {
        self.observer.event(event);
        match event {
            Event::Died { stage, how, next } => self.outages.begin(*stage, *next, how),
            Event::GivenUp { stage, how, why } => self.outages.give_up(*stage, format!("{how}; {why}")),
            Event::HandedOver(replaced) => self.outages.handed_over(replaced),
            Event::Tried(replaced) => self.outages.tried(replaced),
            Event::Promoted { stage } => self.outages.promoted(*stage),
            Event::Starved { stage } => self.outages.starved(*stage),
            Event::NotReady { .. } => self.outages.not_ready(),
            Event::CannotDie { .. }
            | Event::CleanUpHung(_)
            | Event::ReaderDied(_)
            | Event::SpareGivenUp { .. } => {}
        }
    }

    /// Sets the stage that a run which has not begun waits for.
    pub fn wait_for(&mut self, stage: Option<StageId>) {
        self.observer.wait_for(stage);
    }

    /// Logs a setting of pipeline.toml that the system refused, and keeps it for the report.
    pub fn note(&mut self, note: String) {
        tracing::warn!(target: "launcher", "{note}");
        self.outages.note(note);
    }

    /// Logs that files of the run's folder were removed and restored.
    pub fn restored(&mut self, files: usize) {
        let text = format!("another program has removed files of the run's folder; restored: {files}");
        self.observer.report(text);
    }

    /// Returns the run's status.
    pub fn status(&mut self, fleet: &Fleet) -> RunStatus {
        self.observer.status(fleet, &self.outages, self.peers.unlinked().is_empty())
    }

    fn show(&mut self, fleet: &Fleet) {
        let every = match self.display {
            Display::Table(_) => UPDATE,
            Display::Lines if self.ticks() > self.printed_ticks => LINE,
            Display::Lines | Display::Quiet => return,
        };
        if self.shown.elapsed() < every {
            return;
        }
        self.shown = Instant::now();
        self.printed_ticks = self.ticks();
        let status = self.status(fleet);
        match &mut self.display {
            Display::Table(table) => {
                log::lines_above(|lines| table.print(lines));
                let [width, height] = terminal::size();
                let view = View::new(status, SortBy::Chain, None);
                table.draw(&view.table(width, ROWS.min(height.saturating_sub(1))));
            }
            Display::Lines | Display::Quiet => tracing::info!("{}", status.line()),
        }
    }

    /// Shows the last lines, clears the table and restores the cursor. `undead` are the processes that did not end.
    /// Returns the costs of outages, and failures of files about the run.
    pub fn close(mut self, undead: &[(StageId, Pid)], fleet: &Fleet) -> (Outages, Vec<Failure>) {
        for &(stage, pid) in undead {
            self.say(&Event::CannotDie { stage, pid });
            self.outages.not_ended(stage, pid);
        }
        self.count_lost_lines(fleet);
        let unwritten = self.observer.close(fleet, &self.outages);
        log::above_table(false);
        if let Display::Table(table) = &self.display {
            log::lines_above(|lines| table.print(lines));
            table.close();
        }
        (self.outages, unwritten)
    }
}

impl Display {
    fn for_output() -> Self {
        let table = Table::on_output();
        log::above_table(table.is_some());
        table.map_or(Self::Lines, Self::Table)
    }
}
