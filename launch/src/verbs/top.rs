use std::io::{IsTerminal, stdout};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use console::failure::Failure;
use console::say;
use console::show::show;
use console::streams::{self, Stream};
use console::terminal::{self, Key, Screen};
use ports::escaped;
use run::Exit;
use telemetry::top::{Client, SortBy, View, text};

use crate::runs;

/// Width of the table if the output is not a terminal.
const WIDTH: usize = 100;
/// Maximum interval between checks of the terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Arguments of `stgdat top`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Print the state once and exit
    #[arg(long)]
    once: bool,
    /// Print the state as JSON, one line per update
    #[arg(long)]
    json: bool,
    /// Time between updates, in seconds
    #[arg(long, value_name = "SECONDS", default_value = "0.5", value_parser = interval)]
    interval: Duration,
    /// Order of the stages
    #[arg(long, value_enum, default_value = "chain")]
    sort: SortBy,
    /// Show only this stage
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
        let width = if stdout().is_terminal() { terminal::size()[0] } else { WIDTH };
        return show(&text(&view, width));
    }
    if follow(&client, &mut view, arguments.interval)? {
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
        if !streams::write(Stream::Output, None, &(escaped(&line, false).into_owned() + "\n"))
            || arguments.once
        {
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
    let mut screen = Screen::open().map_err(|error| Failure::unavailable_about("the terminal", error))?;
    let mut asked = Instant::now();
    loop {
        let size = terminal::size();
        screen.draw(&view.screen(size[0], size[1]), size);
        let left = interval.saturating_sub(asked.elapsed());
        let keys = screen.keys(left.min(LOOK)).map_err(Failure::unavailable)?;
        if keys.into_iter().any(|key| press(view, key)) {
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
fn press(view: &mut View, key: Key) -> bool {
    match key {
        Key::Char('q') | Key::Interrupt => return true,
        Key::Escape if !view.leave_stage() => return true,
        Key::Char('p' | ' ') => view.pause(),
        Key::Char('s') => view.sort_by_next(),
        Key::Down | Key::Char('j') => view.select(1),
        Key::Up | Key::Char('k') => view.select(-1),
        Key::Enter => view.enter_stage(),
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
        let mut press = |key| super::press(&mut view, key);
        assert!(!press(Key::Down) && !press(Key::Enter));
        assert!(!press(Key::Escape), "back to all stages first");
        assert!(press(Key::Escape) && press(Key::Char('q')));
    }
}
