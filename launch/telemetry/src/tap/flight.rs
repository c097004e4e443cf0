//! A flight recorder: keeps the newest messages of a run in memory and writes them to a file when an event
//! happens.

use std::io;
use std::path::{Path, PathBuf};

use ports::{Asked, monotonic_ns};
use recorder::Tick;
use recording::flight::{Act, Flight, Trigger, caused_by};
use recording::{About, Before, Event, Forgotten, Happened, Message, Ring, WriteError, Writer, Written};
use wire::{Forecast, ForecastsTopic, Header, Topic};

use super::follow::Keep;
use super::ring_arguments::{Limits, numbered};

/// Keeps a ring of messages and writes it to numbered files.
pub struct FlightRecorder<C> {
    ring: Ring,
    before: Before,
    flight: Flight,
    asked: Asked,
    /// The path from which the file names are derived.
    path: PathBuf,
    about: About,
    /// The open file, with the event that started it.
    file: Option<(PathBuf, String, Writer)>,
    written: Written,
    error: Option<io::Error>,
    is_cut_reported: bool,
    say: fn(&str),
    create: C,
}

/// The fault of a tick, in words; `None` if it has none.
fn wrong_with(header: &Header, forecasts: &[Forecast]) -> Option<(Trigger, String)> {
    let tick = header.is_tick().then(|| Tick::alone(header, forecasts))?;
    let trigger = if tick.is_late() { Trigger::Late } else { Trigger::Degraded };
    tick.fault().map(|why| (trigger, why))
}

impl<C: Fn(&Path, &About) -> Result<Writer, WriteError>> FlightRecorder<C> {
    /// Creates an empty ring; `say` reports each file that `create` has created.
    pub fn new(path: &Path, about: About, limits: Limits, asked: Asked, say: fn(&str), create: C) -> Self {
        Self {
            ring: Ring::new(limits.ring),
            before: Before::new(limits.before_bytes, &about.topics),
            flight: Flight::new(limits.flight),
            asked,
            path: path.to_owned(),
            about,
            file: None,
            written: Written::default(),
            error: None,
            is_cut_reported: false,
            say,
            create,
        }
    }

    fn cause(&mut self, trigger: Trigger, why: String, at_ns: u64) {
        match self.flight.cause(trigger, at_ns) {
            Act::Keep => {}
            Act::Full => (self.say)(&format!("no file is written of: {why}")),
            Act::Join => self.note(why, at_ns),
            Act::Begin(number) => {
                let path = numbered(&self.path, number);
                let about = About { before: self.before.is_whole(), ..self.about.clone() };
                match (self.create)(&path, &about) {
                    Ok(mut writer) => {
                        self.before.frames().for_each(|frame| writer.before(&frame));
                        self.ring.messages().for_each(|message| writer.add(message));
                        self.file = Some((path, why.clone(), writer));
                        self.note(why, at_ns);
                    }
                    // The next event is tried again.
                    Err(WriteError { source, .. }) => self.error = Some(source),
                }
            }
        }
    }

    fn note(&mut self, why: String, at_ns: u64) {
        if let Some((.., writer)) = &mut self.file {
            writer.event(&Event { at_ns, what: Happened::Kept { why } });
        }
    }

    /// Closes the open file once its time is over, and checks for requests for a file.
    fn look(&mut self, now_ns: u64) {
        if self.flight.ends(now_ns) {
            self.close("its time after the event was over");
        }
        if self.asked.take() {
            self.cause(Trigger::Asked, "asked for by SIGUSR1".to_owned(), now_ns);
        }
    }

    fn close(&mut self, how: &str) {
        let Some((path, why, writer)) = self.file.take() else { return };
        match writer.finish(how) {
            Ok(written) => {
                let megabytes = written.bytes as f64 / 1e6;
                (self.say)(&format!("{}: {megabytes:.1} MB: {why}", path.display()));
                self.add(&written);
            }
            Err(WriteError { source, .. }) => self.error = Some(source),
        }
    }

    /// Adds the result of a file.
    fn add(&mut self, file: &Written) {
        self.written.messages += file.messages;
        self.written.bytes += file.bytes;
        self.written.uncompressed_bytes += file.uncompressed_bytes;
        let sums = [(&mut self.written.by_topic, &file.by_topic), (&mut self.written.lost, &file.lost)];
        for (sums, of_file) in sums {
            of_file.iter().for_each(|(topic, len)| *sums.entry(topic.clone()).or_default() += len);
        }
    }
}

impl<C: Fn(&Path, &About) -> Result<Writer, WriteError>> Keep for FlightRecorder<C> {
    fn keep(&mut self, mut message: Message) {
        // Data that no file will contain must not take memory.
        if let Message::Frame(frame) = &mut message
            && let Some(bytes) = self.about.element_bytes.get(frame.topic().name)
        {
            *frame = frame.leading(*bytes);
        }
        let at_ns = message.at_ns();
        let cause = match &message {
            Message::Frame(frame) if frame.topic().name == ForecastsTopic::NAME => {
                let forecasts = frame.elements::<ForecastsTopic>().ok();
                forecasts.and_then(|forecasts| wrong_with(frame.header(), &forecasts))
            }
            Message::Event(event) => caused_by(event).map(|trigger| (trigger, event.what.to_string())),
            Message::Frame(_) | Message::Before(_) | Message::Line(_) => None,
        };
        if let Some((.., writer)) = &mut self.file {
            writer.add(&message);
        }
        let (before, say) = (&mut self.before, self.say);
        self.ring.push(message, |gone| {
            let Message::Frame(frame) = &gone else { return };
            match before.push(frame) {
                Some(Forgotten::HadBegun) => say("the run had begun before: replays will not have what the stages remember"),
                Some(Forgotten::TooMuch) => say(
                    "the time before the ring has no room any more, replays will not have what the stages remember: \
                     --before-mib gives it more",
                ),
                None => {}
            }
        });
        if self.ring.is_cut() && !std::mem::replace(&mut self.is_cut_reported, true) {
            let seconds = self.ring.span_ns() as f64 / 1e9;
            (self.say)(&format!("the memory holds {seconds:.0} s: --ring-mib gives it more"));
        }
        if let Some((trigger, why)) = cause {
            self.cause(trigger, why, at_ns);
        }
        self.look(at_ns);
    }

    fn idle(&mut self) {
        if let Some((.., writer)) = &mut self.file {
            writer.flush();
        }
        self.look(monotonic_ns());
    }

    fn take_error(&mut self) -> Option<io::Error> {
        let of_file = self.file.as_mut().and_then(|(.., writer)| writer.take_error());
        self.error.take().or(of_file)
    }

    fn finish(mut self, how: &str) -> Result<Written, WriteError> {
        self.close(how);
        if self.flight.missed() > 0 {
            let (missed, files) = (self.flight.missed(), self.flight.files());
            (self.say)(&format!("{missed} events came after the {files} files of --files"));
        }
        match self.error.take() {
            Some(source) => Err(WriteError { path: self.path, source }),
            None => Ok(self.written),
        }
    }
}
