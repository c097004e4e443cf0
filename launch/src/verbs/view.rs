use std::ffi::OsString;
use std::io::{IsTerminal as _, stdin, stdout};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use clap::Args;
use configuration::options::absolute;
use console::failure::Failure;
use console::log;
use console::program::this_program;
use console::siblings::replace_by;
use ports::{LivingRun, Stop};
use recording::About;
use recording::tap::{Client as TapClient, Item, Request};
use run::Exit;
use rustix::process::{Pid, Signal, kill_process};
use supervisor::{die_with_this_process, end_within};
use telemetry::observe::address;
use telemetry::top::Client;
use view::{Foresight, Live, MODES_DRAWN, Pairing, Scene};
use wire::{ForecastsTopic, MODES_MAX, Topic as _, TracksTopic};

use crate::arguments::{lanes_of, map_path};
use crate::runs;

/// The address if none is named; any free port if this one is taken.
const ADDRESS: ([u8; 4], u16) = ([127, 0, 0, 1], 9465);
/// Interval between questions for the status.
const STATUS: Duration = Duration::from_millis(500);
/// Longest wait for an item or a browser.
const WAIT: Duration = Duration::from_millis(200);
/// Time limit for browsers to receive the end of the run.
const END_LIMIT: Duration = Duration::from_secs(3);
/// Time after the end of a run in which a view ends that nobody has watched, and the interval between two looks.
const DECISION_LIMIT: Duration = Duration::from_millis(800);
const LOOK: Duration = Duration::from_millis(50);
/// Nice value of the server, so that the stages come first.
const NICE: i32 = 10;

/// Arguments of `stgdat view`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Serve the page on this address, or on this port of the loopback interface. The URL has a token if the
    /// address is not of the loopback interface
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    address: Option<SocketAddr>,
    /// Serve Foxglove's websocket instead of the page, by default on port 8765 of the loopback interface. An
    /// address that other machines reach has no token
    #[arg(long)]
    foxglove: bool,
    /// Paths of each agent in Foxglove, the most probable first
    #[arg(long, value_name = "N", requires = "foxglove", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=MODES_MAX as i64))]
    paths: u16,
    /// Leave it to the launcher to state that the page stays
    #[arg(long, hide = true)]
    of_run: bool,
}

/// The server of Foxglove's websocket, and the option that it is built with.
const FOXGLOVE: [&str; 2] = ["stgdat-foxglove", " --features websocket"];

/// Serves the live page of a run until the run ends; afterwards until Ctrl-C if a browser has watched, so that the page
/// can be loaded again.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let _ = rustix::process::nice(NICE);
    if arguments.foxglove {
        let [name, options] = FOXGLOVE;
        let words = foxglove_arguments(arguments, &run)?;
        return Err(replace_by(name, options, words.into_iter()));
    }
    let stop = Stop::on_signals().map_err(Failure::unavailable)?;
    let hello = hello(&run)?;
    let wanted = arguments.address.unwrap_or_else(|| ADDRESS.into());
    let live = Live::serve(wanted, &hello).or_else(|error| match arguments.address {
        // Another run has a page already.
        None => Live::serve(SocketAddr::from((ADDRESS.0, 0)), &hello),
        Some(_) => Err(error),
    });
    let live = live.map_err(|error| Failure::unavailable_about(format!("the page on {wanted}"), error))?;
    log::print_line(&format!("{} shows {} in a browser; Ctrl-C ends it", live.url(), run.name));
    let client = Client::new(&run.root);
    let mut was_watched = false;
    while !stop.requested() && client.is_there() {
        // Without a browser nothing is read.
        if live.wait_for_browser(WAIT) {
            was_watched = true;
            follow(&run, &client, &live, &stop)?;
        }
    }
    live.end(END_LIMIT);
    if was_watched && !stop.requested() {
        if !arguments.of_run {
            log::print_line(&format!("{} has ended; the page stays until Ctrl-C", run.name));
        }
        while !stop.requested() {
            std::thread::sleep(WAIT);
        }
    }
    Ok(Exit::Done)
}

fn foxglove_arguments(arguments: &Arguments, run: &LivingRun) -> Result<Vec<OsString>, Failure> {
    let mut words = vec!["--run".into(), run.root.clone().into_os_string()];
    words.extend(["--paths".into(), arguments.paths.to_string().into()]);
    if let Some(address) = arguments.address {
        words.extend(["--address".into(), address.to_string().into()]);
    }
    let about = About::of_run(&run.root).map_err(|error| Failure::file(&run.root, error))?;
    if let Some(path) = map_path(&about.run) {
        words.extend(["--map".into(), absolute(&path)?.into_os_string()]);
    }
    Ok(words)
}

/// The facts of a run that do not change, as JSON: its title and the bounds of its lanes.
fn hello(run: &LivingRun) -> Result<String, Failure> {
    let about = About::of_run(&run.root).map_err(|error| Failure::file(&run.root, error))?;
    let title = serde_json::to_string(&about.scene).map_err(Failure::data)?;
    let lanes = lanes_of(&about.run)?.map_or_else(|| "[]".to_owned(), |map| view::lanes_json(&map));
    Ok(format!("{{\"title\":{title},\"lanes\":{lanes}}}"))
}

/// Shows the run's ticks while a browser watches.
fn follow(run: &LivingRun, status: &Client, live: &Live, stop: &Stop) -> Result<(), Failure> {
    let topics = vec![TracksTopic::NAME.to_owned(), ForecastsTopic::NAME.to_owned()];
    let request = Request { tool: "view".to_owned(), topics, events: false, mark: None, recording: None };
    // The run may end at this moment.
    let Ok(mut tap) = TapClient::attach(&run.root, &request) else {
        std::thread::sleep(WAIT);
        return Ok(());
    };
    let mut pairing = Pairing::default();
    let mut foresight = Foresight::default();
    let mut asked: Option<Instant> = None;
    while live.browsers() > 0 && !stop.requested() && !tap.is_closed() {
        match tap.next(WAIT).map_err(Failure::unavailable)? {
            Some(Item::Frame(frame)) => {
                if let Some((view, forecasts)) = pairing.take(frame) {
                    let foreseen = foresight.of(&view, &forecasts);
                    let scene = Scene::new(&view, MODES_DRAWN).foreseen(&view, &foreseen);
                    live.tick(&scene.to_json());
                }
            }
            Some(Item::Refused(why)) => return Err(Failure::unavailable_about(&run.name, why)),
            // The page shows the losses of the run itself, which the status counts.
            Some(_) | None => {}
        }
        if asked.is_none_or(|asked| asked.elapsed() >= STATUS) {
            asked = Some(Instant::now());
            // A launcher that is busy is asked again later.
            if let Ok(status) = status.ask() {
                live.status(&serde_json::to_string(&status).map_err(Failure::data)?);
            }
        }
    }
    Ok(())
}

/// A view that the launcher starts with a run.
#[derive(Debug)]
pub struct Page(Child);

impl Page {
    /// Starts `stgdat view` for a run. It prints the page's URL.
    pub fn start(root: &Path, address: Option<SocketAddr>) -> Result<Self, Failure> {
        let mut command = Command::new(this_program());
        command.arg("view").arg("--of-run").arg("--run").arg(root).stdin(Stdio::null());
        if let Some(address) = address {
            command.arg("--address").arg(address.to_string());
        }
        die_with_this_process(log::pass_on(&mut command));
        command.spawn().map(Self).map_err(Failure::unavailable)
    }

    /// Keeps the page after the end of the run until `stop` is requested, if a browser has watched.
    pub fn stay(mut self, stop: &Stop) {
        let ended = Instant::now();
        let mut is_stated = false;
        while !stop.requested() && matches!(self.0.try_wait(), Ok(None)) {
            // The view ends if nobody has watched.
            if !is_stated && ended.elapsed() >= DECISION_LIMIT {
                log::print_line("The run has ended; the page stays until Ctrl-C");
                is_stated = true;
            }
            std::thread::sleep(LOOK);
        }
    }
}

/// Whether a person at a terminal sees the lines of this process: not a service, a pipe or CI.
#[must_use]
pub fn is_attended() -> bool {
    stdin().is_terminal() && stdout().is_terminal() && std::env::var_os("CI").is_none()
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = kill_process(Pid::from_child(&self.0), Signal::TERM);
        // It first tells its browsers that the run has ended.
        end_within(&mut self.0, END_LIMIT + WAIT);
    }
}
