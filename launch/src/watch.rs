use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use ports::{Beside, Node, Peers, Subscriber, monotonic_ns};
use recorder::live::{LiveOptions, LiveView, lines};
use run::Run;
use wire::{ForecastsTopic, Header, Heartbeat, HeartbeatsTopic, StageId, Topic};

use crate::child::Line;
use crate::failure::Failure;
use crate::fleet::{Event, Fleet};
use crate::log;
use crate::observe::Observer;
use crate::outages::Outages;
use crate::terminal::{self, Table};

/// Interval between updates of the table, which is also the longest sleep.
const UPDATE: Duration = Duration::from_millis(100);
/// Interval between lines if the output is not a terminal.
const LINE: Duration = Duration::from_secs(1);
/// Interval between reads of the forecast errors from the recorder.
const ERRORS: Duration = Duration::from_secs(1);
/// Maximum number of rows of the table.
const ROWS: usize = 23;

/// Follows a run from the launcher: the linked stages and the run's progress.
pub struct Watch {
    forecasts: Subscriber<ForecastsTopic>,
    peers: Peers,
    beside: Beside,
    view: LiveView,
    display: Display,
    shown: Instant,
    /// Time at which the view last received the forecast errors.
    told: Instant,
    printed_ticks: u64,
    outages: Outages,
    observer: Observer,
    /// Header of the newest forecasts.
    newest: Option<Header>,
}

/// How the progress is shown.
#[derive(Debug)]
enum Display {
    /// A table at the bottom of the terminal, and the lines of the log that go above it.
    Table(Table, Receiver<String>),
    /// A line per second in the log.
    Lines,
    /// No display.
    Quiet,
}

impl Watch {
    /// Joins a run as a subscriber.
    pub fn open(run: &Run, options: LiveOptions, quiet: bool, observer: Observer) -> Result<Self, Failure> {
        let node = Node::open(run, "launcher")?;
        Ok(Self {
            forecasts: node.subscriber(ForecastsTopic::DEPTH_MAX)?,
            beside: Beside::open(&node, run)?,
            peers: Peers::new(node.subscriber(HeartbeatsTopic::DEPTH_MAX)?, run),
            view: LiveView::new(options),
            display: if quiet { Display::Quiet } else { Display::for_output() },
            shown: Instant::now(),
            told: Instant::now(),
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
    pub fn follow(
        &mut self,
        lines: impl Iterator<Item = Line>,
        fleet: &Fleet,
    ) -> Result<Vec<Heartbeat>, Failure> {
        self.peers.heartbeats().sleep_or(&fleet.descriptors(), UPDATE / 2)?;
        self.view.spares(fleet.spares());
        let heartbeats = self.peers.listen()?;
        for heartbeat in &heartbeats {
            self.view.heartbeat(heartbeat);
            self.observer.heartbeat(heartbeat);
        }
        self.take_forecasts()?;
        self.view.clock(monotonic_ns());
        if self.told.elapsed() >= ERRORS && matches!(self.display, Display::Table(..)) {
            self.view.errors(self.observer.accuracy());
            self.told = Instant::now();
        }
        lines.for_each(|(stage, line)| log::relay(stage, &line));
        self.show();
        Ok(heartbeats)
    }

    /// Answers questions of tools about the run.
    pub fn answer(&mut self, fleet: &Fleet, is_linked: bool) {
        self.observer.answer(&self.view, fleet, &self.outages, is_linked);
    }

    fn take_forecasts(&mut self) -> Result<(), Failure> {
        while let Some(frame) = self.forecasts.receive()? {
            self.view.forecasts(frame.header(), &frame);
            self.outages.forecasts(frame.header(), &frame);
            self.observer.forecasts(frame.header(), &frame);
            self.newest = Some(*frame.header());
        }
        for header in self.beside.take()? {
            self.view.beside(&header);
            self.observer.beside(&header);
        }
        Ok(())
    }

    /// Returns the number of ticks whose forecasts have arrived.
    pub const fn ticks(&self) -> u64 {
        self.view.ticks()
    }

    /// Sleeps until the forecasts of another tick have arrived, but at most `limit`. At that moment most
    /// stages wait for the next tick.
    pub fn await_tick(&mut self, limit: Duration) -> Result<(), Failure> {
        self.take_forecasts()?;
        let (begun, before) = (Instant::now(), self.view.ticks());
        while self.view.ticks() == before && begun.elapsed() < limit {
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
            Event::Tried(replaced) => {
                self.outages.tried(replaced);
                self.view.replaced(replaced.stage, replaced.outcome);
            }
            Event::Promoted { stage } => self.outages.promoted(*stage),
            Event::Starved { stage } => self.outages.starved(*stage),
            Event::CleanUpHung(_) | Event::ReaderDied(_) | Event::SpareGivenUp { .. } => {}
        }
        if event.is_logged() {
            tracing::warn!(target: "launcher", "{event}");
        }
    }

    /// Logs a setting of pipeline.toml that the system refused, and keeps it for the report.
    pub fn note(&mut self, note: String) {
        tracing::warn!(target: "launcher", "{note}");
        self.outages.note(note);
    }

    /// Logs that files of the run's folder were removed and restored.
    pub fn restored(&mut self, files: usize) {
        let text = format!("another program has removed files of the run's folder; restored: {files}");
        tracing::warn!(target: "launcher", "{text}");
        self.observer.list(text);
    }

    fn show(&mut self) {
        match &mut self.display {
            Display::Table(table, above) if self.shown.elapsed() >= UPDATE => {
                above.try_iter().for_each(|line| table.print(&line));
                let [width, height] = terminal::size();
                table.draw(&lines(&self.view, width, ROWS.min(height.saturating_sub(1))));
            }
            Display::Lines if self.shown.elapsed() >= LINE && self.view.ticks() > self.printed_ticks => {
                self.printed_ticks = self.view.ticks();
                tracing::info!("{}", self.view.plain_line());
            }
            _ => return,
        }
        self.shown = Instant::now();
    }

    /// Shows the last lines, clears the table and restores the cursor. Returns the costs of outages, and
    /// failures of files about the run.
    pub fn close(self, lines: impl Iterator<Item = Line>, fleet: &Fleet) -> (Outages, Vec<Failure>) {
        let unwritten = self.observer.close(&self.view, fleet, &self.outages);
        lines.for_each(|(stage, line)| log::relay(stage, &line));
        log::to_standard_error();
        if let Display::Table(table, above) = &self.display {
            above.try_iter().for_each(|line| table.print(&line));
            table.close();
        }
        (self.outages, unwritten)
    }
}

impl Display {
    fn for_output() -> Self {
        Table::on_output().map_or(Self::Lines, |table| Self::Table(table, log::above_table()))
    }
}
