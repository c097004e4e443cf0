use std::io::{IsTerminal, Stdout, stdout};
use std::time::{Duration, Instant};

use ports::{Beside, Node, Peers, Subscriber, monotonic_ns};
use ratatui::backend::CrosstermBackend;
use ratatui::text::Line as Text;
use ratatui::widgets::Widget;
use ratatui::{Terminal, TerminalOptions, Viewport};
use recorder::live::{LiveOptions, LiveView, draw};
use run::Run;
use wire::{ForecastsTopic, Header, Heartbeat, HeartbeatsTopic, StageId, Topic};

use crate::child::Line;
use crate::color;
use crate::failure::Failure;
use crate::fleet::{Event, Fleet};
use crate::observe::Observer;
use crate::outages::Outages;

/// Interval between updates of the table, which is also the longest sleep.
const UPDATE: Duration = Duration::from_millis(100);
/// Interval between lines if the output is not a terminal.
const LINE: Duration = Duration::from_secs(1);
/// Interval between reads of the forecast errors from the recorder.
const ERRORS: Duration = Duration::from_secs(1);
/// Rows of the table.
const ROWS: u16 = 23;

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
    /// A table at the bottom of the terminal.
    Table(Box<Terminal<CrosstermBackend<Stdout>>>),
    /// A line per second on standard error.
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
        if self.told.elapsed() >= ERRORS && matches!(self.display, Display::Table(_)) {
            self.view.errors(self.observer.accuracy());
            self.told = Instant::now();
        }
        for (stage, line) in lines {
            self.display.line(&format!("{}: {line}", stage.name()));
        }
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

    /// Shows an event of the launcher and keeps it for the report.
    pub fn say(&mut self, event: &Event) {
        self.observer.event(event);
        match event {
            Event::Died { stage, how, next } => {
                self.outages.begin(*stage, *next, how);
                self.display.line(&format!("launcher: the {} {how}: it is started again", stage.name()));
            }
            Event::GivenUp { stage, how, why } => {
                self.outages.give_up(*stage, format!("{how}; {why}"));
                self.display.line(&format!("launcher: the {} {how} and is given up: {why}", stage.name()));
            }
            Event::HandedOver(replaced) => self.outages.handed_over(replaced),
            Event::Tried(replaced) => {
                self.outages.tried(replaced);
                self.view.replaced(replaced.stage, replaced.outcome);
                self.display.line(&format!("launcher: {replaced}"));
            }
            Event::Promoted { stage } => {
                self.outages.promoted(*stage);
                self.display.line(&format!("launcher: the spare of the {} takes its place", stage.name()));
            }
            Event::CleanUpHung(hung) => self.display.line(&format!("launcher: {hung}")),
            Event::ReaderDied(reader) if reader.is_logged() => {
                self.display.line(&format!("launcher: {reader}"));
            }
            Event::ReaderDied(_) => {}
            Event::SpareGivenUp { stage, how } => {
                self.display.line(&format!("launcher: the {}: {how}", stage.name()));
            }
            Event::Starved { stage } => {
                self.outages.starved(*stage);
                self.display.line(&format!("launcher: the {} gets no CPU", stage.name()));
            }
        }
    }

    /// Shows a setting of pipeline.toml that the system refused, and keeps it for the report.
    pub fn note(&mut self, note: String) {
        self.display.line(&format!("launcher: {note}"));
        self.outages.note(note);
    }

    /// Shows that files of the run's folder were removed and restored.
    pub fn restored(&mut self, files: usize) {
        let text = format!("another program has removed files of the run's folder; restored: {files}");
        self.display.line(&format!("launcher: {text}"));
        self.observer.list(text);
    }

    fn show(&mut self) {
        match &mut self.display {
            Display::Table(terminal) if self.shown.elapsed() >= UPDATE => {
                // A closed terminal can't be drawn to. The run does not depend on it.
                let _ = terminal.draw(|frame| draw(&self.view, frame, frame.area()));
            }
            Display::Lines if self.shown.elapsed() >= LINE && self.view.ticks() > self.printed_ticks => {
                self.printed_ticks = self.view.ticks();
                note!("{}", self.view.plain_line());
            }
            _ => return,
        }
        self.shown = Instant::now();
    }

    /// Shows the last lines, clears the table and restores the cursor. Returns the costs of outages, and
    /// failures of files about the run.
    pub fn close(mut self, lines: impl Iterator<Item = Line>, fleet: &Fleet) -> (Outages, Vec<Failure>) {
        let unwritten = self.observer.close(&self.view, fleet, &self.outages);
        for (stage, line) in lines {
            self.display.line(&format!("{}: {line}", stage.name()));
        }
        if let Display::Table(terminal) = &mut self.display {
            let top = terminal.get_frame().area().as_position();
            let _ = terminal.clear();
            let _ = terminal.set_cursor_position(top);
            let _ = terminal.show_cursor();
        }
        (self.outages, unwritten)
    }
}

impl Display {
    fn for_output() -> Self {
        let options = TerminalOptions { viewport: Viewport::Inline(ROWS) };
        if !stdout().is_terminal() {
            return Self::Lines;
        }
        // Fails on terminals that do not report their cursor position.
        Terminal::with_options(CrosstermBackend::new(stdout()), options)
            .map_or(Self::Lines, |terminal| Self::Table(Box::new(terminal)))
    }

    /// Shows a line of a stage's output.
    fn line(&mut self, line: &str) {
        match self {
            Self::Table(terminal) => {
                let _ = terminal.insert_before(1, |buffer| Text::from(line).render(buffer.area, buffer));
            }
            Self::Lines | Self::Quiet if color::choice().is_on(&std::io::stderr()) => {
                note!("{}", color::with_level(line));
            }
            Self::Lines | Self::Quiet => note!("{line}"),
        }
    }
}
