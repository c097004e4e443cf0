use std::io::{IsTerminal, Stdout, stdout};
use std::time::{Duration, Instant};

use ports::{Node, Peers, Subscriber, monotonic_ns};
use ratatui::backend::CrosstermBackend;
use ratatui::text::Line as Text;
use ratatui::widgets::Widget;
use ratatui::{Terminal, TerminalOptions, Viewport};
use recorder::live::{LiveOptions, LiveView, draw};
use run::Run;
use wire::{ForecastsTopic, HeartbeatsTopic, StageId, Topic};

use crate::child::Line;
use crate::failure::Failure;

/// Time between pictures of the table, and the longest sleep.
const PICTURE: Duration = Duration::from_millis(100);
/// Time between lines where the output is no terminal.
const LINE: Duration = Duration::from_secs(1);
/// Rows of the table.
const ROWS: u16 = 22;

/// Follows a run from outside: who is linked, and how it goes.
#[derive(Debug)]
pub struct Watch {
    forecasts: Subscriber<ForecastsTopic>,
    peers: Peers,
    view: LiveView,
    display: Display,
    shown: Instant,
    told_ticks: u64,
}

/// How the run is shown.
#[derive(Debug)]
enum Display {
    /// A table at the foot of the terminal.
    Table(Box<Terminal<CrosstermBackend<Stdout>>>),
    /// Now and then a line on standard error.
    Lines,
    /// Not at all.
    Quiet,
}

impl Watch {
    /// Joins a run as a listener.
    pub fn open(run: &Run, options: LiveOptions, quiet: bool) -> Result<Self, Failure> {
        let node = Node::open(run, "launcher")?;
        Ok(Self {
            forecasts: node.subscriber(ForecastsTopic::DEPTH_MAX)?,
            peers: Peers::new(node.subscriber(HeartbeatsTopic::DEPTH_MAX)?, run),
            view: LiveView::new(options),
            display: if quiet { Display::Quiet } else { Display::for_output() },
            shown: Instant::now(),
            told_ticks: 0,
        })
    }

    /// Stages that are not linked to their neighbours yet.
    pub fn unlinked(&self) -> Vec<StageId> {
        self.peers.unlinked()
    }

    /// Sleeps for a moment, or until something comes; takes it and shows it.
    pub fn follow(&mut self, lines: impl Iterator<Item = Line>) -> Result<(), Failure> {
        self.peers.heartbeats().sleep(PICTURE / 2)?;
        for heartbeat in self.peers.listen()? {
            self.view.heartbeat(&heartbeat);
        }
        while let Some(frame) = self.forecasts.receive()? {
            self.view.forecasts(frame.header(), &frame);
        }
        self.view.clock(monotonic_ns());
        for (stage, line) in lines {
            self.display.tell(&format!("{}: {line}", stage.name()));
        }
        self.show();
        Ok(())
    }

    fn show(&mut self) {
        match &mut self.display {
            Display::Table(terminal) if self.shown.elapsed() >= PICTURE => {
                // A terminal that is gone takes no pictures; the run does not depend on it.
                let _ = terminal.draw(|frame| draw(&self.view, frame, frame.area()));
            }
            Display::Lines if self.shown.elapsed() >= LINE && self.view.ticks() > self.told_ticks => {
                self.told_ticks = self.view.ticks();
                eprintln!("{}", self.view.plain_line());
            }
            _ => return,
        }
        self.shown = Instant::now();
    }

    /// Shows the last lines and leaves the terminal as it was, the cursor where the table began.
    pub fn close(mut self, lines: impl Iterator<Item = Line>) {
        for (stage, line) in lines {
            self.display.tell(&format!("{}: {line}", stage.name()));
        }
        if let Display::Table(terminal) = &mut self.display {
            let top = terminal.get_frame().area().as_position();
            let _ = terminal.clear();
            let _ = terminal.set_cursor_position(top);
            let _ = terminal.show_cursor();
        }
    }
}

impl Display {
    fn for_output() -> Self {
        let options = TerminalOptions { viewport: Viewport::Inline(ROWS) };
        if !stdout().is_terminal() {
            return Self::Lines;
        }
        // Fails on terminals that do not tell where their cursor is.
        Terminal::with_options(CrosstermBackend::new(stdout()), options)
            .map_or(Self::Lines, |terminal| Self::Table(Box::new(terminal)))
    }

    /// Tells a line from one of the stages.
    fn tell(&mut self, line: &str) {
        match self {
            Self::Table(terminal) => {
                let _ = terminal.insert_before(1, |buffer| Text::from(line).render(buffer.area, buffer));
            }
            Self::Lines | Self::Quiet => eprintln!("{line}"),
        }
    }
}
