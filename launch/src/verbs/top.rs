use std::io::{IsTerminal, Write, stdout};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use run::Exit;

use crate::failure::Failure;
use crate::runs;
use crate::show::show;
use crate::top::{Client, SortBy, View, text};

/// Width of the table if the output is not a terminal.
const WIDTH: u16 = 100;
/// Maximum interval between checks of the terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Arguments of `stgdat top`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name or folder of the run; not needed where only one goes on
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Show the run once and end
    #[arg(long)]
    once: bool,
    /// Print the status as JSON, one line each time
    #[arg(long)]
    json: bool,
    /// Seconds between two looks at the run
    #[arg(long, value_name = "SECONDS", default_value = "0.5", value_parser = interval)]
    interval: Duration,
    /// Order of the stages
    #[arg(long, value_enum, default_value = "chain")]
    sort: SortBy,
    /// Show this stage alone
    #[arg(long, value_name = "NAME")]
    stage: Option<String>,
}

fn interval(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    if !(0.1..=60.0).contains(&seconds) {
        return Err("expected 0.1 to 60 seconds".to_owned());
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Attaches to a run and shows it.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let client = Client::new(&run.root);
    let status = client.ask()?;
    if let Some(name) = &arguments.stage
        && !status.stages.iter().any(|stage| stage.name == *name)
    {
        let names: Vec<&str> = status.stages.iter().map(|stage| stage.name.as_str()).collect();
        return Err(Failure::Usage(format!("there is no stage {name}; there are {}", names.join(", "))));
    }
    let mut view = View::new(status, arguments.sort, arguments.stage.clone());
    if arguments.json {
        return print_json(&client, &view, arguments);
    }
    if arguments.once || !stdout().is_terminal() {
        let width = rustix::termios::tcgetwinsize(stdout()).map_or(WIDTH, |size| size.ws_col.max(1));
        return show(&text(&view, width));
    }
    let followed = follow(&client, &mut view, arguments.interval);
    ratatui::restore();
    if followed? {
        say!("{}\nThe run {} has ended.", text(&view, WIDTH), view.status().run);
    }
    Ok(Exit::Done)
}

/// Prints the status until the run ends, or once.
fn print_json(client: &Client, view: &View, arguments: &Arguments) -> Result<Exit, Failure> {
    let mut status = view.status().clone();
    loop {
        let line = serde_json::to_string(&status).map_err(Failure::data)?;
        // The reader may have closed its end.
        if writeln!(stdout(), "{line}").and_then(|()| stdout().flush()).is_err() || arguments.once {
            return Ok(Exit::Done);
        }
        std::thread::sleep(arguments.interval);
        match client.ask() {
            Ok(next) => status = next,
            Err(_) if !client.is_there() => return Ok(Exit::Done),
            Err(failure) => return Err(failure),
        }
    }
}

/// Shows the run until a key ends the view. Returns true if the run has ended.
fn follow(client: &Client, view: &mut View, interval: Duration) -> Result<bool, Failure> {
    let mut terminal = ratatui::try_init().map_err(Failure::unavailable)?;
    let mut asked = Instant::now();
    loop {
        terminal.draw(|frame| view.draw(frame)).map_err(Failure::unavailable)?;
        let left = interval.saturating_sub(asked.elapsed());
        if event::poll(left.min(LOOK)).map_err(Failure::unavailable)?
            && let Event::Key(key) = event::read().map_err(Failure::unavailable)?
            && key.kind == KeyEventKind::Press
            && press(view, key)
        {
            return Ok(false);
        }
        if asked.elapsed() < interval {
            continue;
        }
        asked = Instant::now();
        match client.ask() {
            Ok(status) => view.update(status),
            Err(_) if !client.is_there() => return Ok(true),
            // The launcher may be busy with the run's end; the next poll decides.
            Err(_) => view.silent(),
        }
    }
}

/// Handles a key. Returns true if it ends the view.
fn press(view: &mut View, key: KeyEvent) -> bool {
    match key.code {
        KeyCode::Char('q') => return true,
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return true,
        KeyCode::Esc if !view.leave_stage() => return true,
        KeyCode::Char('p' | ' ') => view.pause(),
        KeyCode::Char('s') => view.sort_by_next(),
        KeyCode::Down | KeyCode::Char('j') => view.select(1),
        KeyCode::Up | KeyCode::Char('k') => view.select(-1),
        KeyCode::Enter => view.enter_stage(),
        _ => {}
    }
    false
}

#[cfg(test)]
mod tests {
    use recorder::status::RunStatus;

    use super::*;

    #[test]
    fn an_interval_is_bounded() {
        assert_eq!(interval("0.5"), Ok(Duration::from_millis(500)));
        assert!(interval("0").is_err() && interval("x").is_err() && interval("1e9").is_err());
    }

    #[test]
    fn keys_end_pause_and_select() {
        let stage =
            |name: &str| recorder::status::StageStatus { name: name.to_owned(), ..Default::default() };
        let status = RunStatus { stages: vec![stage("source"), stage("tracker")], ..RunStatus::default() };
        let mut view = View::new(status, SortBy::Chain, None);
        let mut press = |code| super::press(&mut view, KeyEvent::new(code, KeyModifiers::NONE));
        assert!(!press(KeyCode::Down) && !press(KeyCode::Enter));
        assert!(!press(KeyCode::Esc), "back to all stages first");
        assert!(press(KeyCode::Esc) && press(KeyCode::Char('q')));
    }
}
