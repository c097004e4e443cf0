use std::path::PathBuf;

use clap::Args;
use console::failure::Failure;
use console::show::show;
use recorder::{Recorder, RecorderOptions, Tick};
use recording::{Event, Frame, Happened, Message, ReadError, Recording};
use run::Exit;
use telemetry::waterfall::{FrameOf, WholeTick};
use wire::{Forecast, ForecastsTopic, Header, HeartbeatsTopic, Topic};

use crate::recorded;

/// Width of lines if the output is not a terminal.
const WIDTH: usize = 100;
/// Events within this time before and after the tick are printed with it.
const NEAR_NS: u64 = 500_000_000;

/// Arguments of `stgdat tick`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recording of a run, as `run --record` and `record` write them
    file: PathBuf,
    /// Number of the tick
    tick: u64,
}

/// Prints one tick of a recorded run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (whole_tick, damages) = explain(arguments)?;
    let width = rustix::termios::tcgetwinsize(std::io::stdout())
        .map_or(WIDTH, |size| usize::from(size.ws_col).max(1));
    let exit = show(&whole_tick.render(width))?;
    recorded::end_with(damages).map(|_| exit)
}

/// Reads the tick's data from the file. Also returns the damaged parts of the file.
fn explain(arguments: &Arguments) -> Result<(WholeTick, Vec<ReadError>), Failure> {
    let recording = recorded::open(&arguments.file)?;
    let mut search = Search::new(arguments.tick, &recording);
    let mut damages = Vec::new();
    for message in recording.messages() {
        match message {
            Ok(message) => search.take(&message),
            Err(error) => damages.push(error),
        }
    }
    let Some(Found { header, tick, forecasts }) = search.found else {
        return Err(Failure::data_about(arguments.file.display(), search.missing()));
    };
    let [first_ns, last_ns] = [header.released_ns, header.hops().last().map_or(0, |hop| hop.sent_ns)];
    let near = |at_ns: u64| at_ns + NEAR_NS >= first_ns && at_ns <= last_ns + NEAR_NS;
    let whole_tick = WholeTick {
        tick,
        frames: search.frames,
        cause: search.recorder.explained(),
        begun_ns: search.begun_ns.unwrap_or(header.released_ns),
        events: search.events.into_iter().filter(|(at_ns, _)| near(*at_ns)).collect(),
        header,
        forecasts,
    };
    Ok((whole_tick, damages))
}

/// The tick's header, figures and forecasts.
struct Found {
    header: Header,
    tick: Tick,
    forecasts: Vec<Forecast>,
}

/// Searches for a tick in the messages of a recording.
struct Search {
    tick: u64,
    recorder: Recorder,
    found: Option<Found>,
    frames: Vec<FrameOf>,
    events: Vec<(u64, String)>,
    begun_ns: Option<u64>,
    /// First and last tick with forecasts.
    range: Option<[u64; 2]>,
}

impl Search {
    fn new(tick: u64, recording: &Recording) -> Self {
        let options = RecorderOptions {
            budgets_ms: recording.about().run.budgets_ms(),
            scores: false,
            explain: Some(tick),
            ..RecorderOptions::default()
        };
        Self {
            tick,
            recorder: Recorder::new(options),
            found: None,
            frames: Vec::new(),
            events: Vec::new(),
            begun_ns: None,
            range: None,
        }
    }

    fn take(&mut self, message: &Message) {
        match message {
            Message::Frame(frame) => self.frame(frame),
            Message::Event(Event { what: Happened::Linked | Happened::Ended { .. }, .. }) => {}
            Message::Event(Event { at_ns, what }) => self.events.push((*at_ns, what.to_string())),
            Message::Before(_) | Message::Line(_) => {}
        }
    }

    fn frame(&mut self, frame: &Frame) {
        let header = frame.header();
        let is_ours = header.seq == self.tick && header.is_tick();
        let topic = frame.topic().name;
        if is_ours && topic != HeartbeatsTopic::NAME {
            let elements = frame.elements_len();
            self.frames.push(FrameOf { topic, elements, bytes: frame.bytes().len() });
        }
        if topic != ForecastsTopic::NAME {
            return;
        }
        let forecasts = match frame.elements::<ForecastsTopic>() {
            Ok(forecasts) => forecasts,
            Err(error) => {
                tracing::warn!("{error}");
                return;
            }
        };
        // The recorder counts frames that it refuses. The tick is printed anyway.
        let tick = self.recorder.forecasts(header, &forecasts).ok().flatten();
        if !header.is_tick() {
            return;
        }
        self.begun_ns.get_or_insert(header.released_ns);
        let range = self.range.get_or_insert([header.seq; 2]);
        *range = [range[0].min(header.seq), range[1].max(header.seq)];
        // Readers refuse a repeated tick.
        if is_ours && self.found.is_none() {
            let tick = tick.unwrap_or_else(|| Tick::alone(header, &forecasts));
            self.found = Some(Found { header: *header, tick, forecasts });
        }
    }

    /// Describes why the tick is missing.
    fn missing(&self) -> String {
        let Some([first, last]) = self.range else { return "it has no forecasts".to_owned() };
        let mut why =
            format!("no forecasts of tick {}: those of ticks {first} to {last} are there", self.tick);
        if !self.frames.is_empty() {
            let topics: Vec<&str> = self.frames.iter().map(|frame| frame.topic).collect();
            why += &format!("; of this tick there is only {}", topics.join(", "));
        }
        why
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_is_told_with_its_cause_and_its_agents() {
        let folder = std::env::temp_dir().join(format!("stgdat_tick_{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder can be made");
        let file = folder.join("a.mcap");
        recorded::tests::write(&file);
        let explained = |tick| explain(&Arguments { file: file.clone(), tick });
        let (whole_tick, damages) = explained(7).expect("it is there");
        assert!(damages.is_empty());
        let text = whole_tick.render(100);
        for part in [
            "its controls did not arrive: the decoder was restarted; 1 of 1 forecasts not learned (late)",
            "recorded: 1 detections, 1 forecasts",
            "the decoder was killed by signal 9, and is started again",
            "late",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let error = explained(99).expect_err("there are ten").to_string();
        assert!(error.contains("no forecasts of tick 99: those of ticks 0 to 9 are there"), "{error}");
        std::fs::remove_dir_all(folder).expect("the folder is ours");
    }
}
