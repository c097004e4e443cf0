//! A recording that follows the tap of a run.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use ports::{Stop, monotonic_ns};
use recording::tap::{Client, Item, Request};
use recording::{Event, Happened, Losses, Message, WriteError, Writer, Written};

use console::failure::Failure;

/// Longest wait for an item between checks for a request to end.
const WAIT: Duration = Duration::from_millis(200);
/// Time to wait for a dead tap to return while the run continues.
const RETURN_LIMIT: Duration = Duration::from_secs(5);

/// A destination for the messages of a run.
pub trait Keep {
    /// Stores a message.
    fn keep(&mut self, message: Message);
    /// Called if no message has arrived for a while.
    fn idle(&mut self);
    /// Takes the last disk error, if any.
    fn take_error(&mut self) -> Option<std::io::Error>;
    /// Finishes the file; `how` is the reason for the end.
    fn finish(self, how: &str) -> Result<Written, WriteError>;
}

impl Keep for Writer {
    fn keep(&mut self, message: Message) {
        self.add(&message);
    }

    /// Makes the data so far safe on disk.
    fn idle(&mut self) {
        self.flush();
    }

    fn take_error(&mut self) -> Option<std::io::Error> {
        Self::take_error(self)
    }

    fn finish(self, how: &str) -> Result<Written, WriteError> {
        Self::finish(self, how)
    }
}

/// The result of a recording.
#[derive(Debug, Default)]
pub struct Recorded {
    /// The content of the file.
    pub written: Written,
    /// Frames that the tap or its queue has lost, by topic.
    pub lost: Losses,
    /// Duration of the recording.
    pub seconds: f64,
}

/// Why following ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Followed {
    /// The process was asked to end.
    Stopped,
    /// The time limit was reached.
    TimeOver,
    /// The run has ended.
    RunEnded,
    /// The tap closed before it reported the end of the run, so its last data are missing.
    TapGone,
}

impl Followed {
    const fn words(self) -> &'static str {
        match self {
            Self::Stopped => "the recording was ended",
            Self::TimeOver => "its time was over",
            Self::RunEnded => "the run has ended",
            Self::TapGone => {
                "the tap was killed with its run, or gave up waiting: the last frames may be missing"
            }
        }
    }
}

/// Forwards all messages until the run ends, `limit` is over or the process is asked to end. Events and log
/// lines are forwarded if `events` is set. They are always requested, because they report the run's end.
pub fn follow(
    root: &Path,
    request: &Request,
    mut client: Client,
    mut writer: impl Keep,
    events: bool,
    limit: Option<Duration>,
    stop: &Stop,
) -> Result<Recorded, Failure> {
    let begun = Instant::now();
    let mut lost = BTreeMap::new();
    let (mut reported_error, mut has_ended) = (None, false);
    let how = loop {
        if stop.requested() {
            break Followed::Stopped;
        }
        if limit.is_some_and(|limit| begun.elapsed() >= limit) {
            break Followed::TimeOver;
        }
        let left = limit.map_or(WAIT, |limit| limit.saturating_sub(begun.elapsed()).min(WAIT));
        match client.next(left).map_err(Failure::unavailable)? {
            Some(Item::Attached) => {
                let text = "the tap has died and was started again: frames between are missing".to_owned();
                writer.keep(Message::Event(Event { at_ns: monotonic_ns(), what: Happened::Mark { text } }));
            }
            Some(item) => {
                has_ended |=
                    matches!(&item, Item::Event(event) if matches!(event.what, Happened::Ended { .. }));
                if events || !matches!(item, Item::Event(_) | Item::Line(_)) {
                    add(&mut writer, item, &mut lost);
                }
            }
            None if client.is_closed() && has_ended => break Followed::RunEnded,
            None if client.is_closed() => match again(root, request, stop) {
                Some(next) => client = next,
                None => break Followed::TapGone,
            },
            None => writer.idle(),
        }
        if let Some(error) = writer.take_error() {
            // Reported once per kind of error, because a full disk stays full.
            if reported_error != Some(error.kind()) {
                reported_error = Some(error.kind());
                tracing::warn!("recording: {error}: frames are lost until the disk has space again");
            }
        }
    };
    let written = writer.finish(how.words()).map_err(Failure::data)?;
    Ok(Recorded { written, lost, seconds: begun.elapsed().as_secs_f64() })
}

fn add(writer: &mut impl Keep, item: Item, lost: &mut Losses) {
    match item {
        Item::Frame(frame) => writer.keep(Message::Frame(frame)),
        Item::Event(event) => writer.keep(Message::Event(event)),
        Item::Line(line) => writer.keep(Message::Line(line)),
        // The caller handles these items. They carry no message of the run.
        Item::Attached | Item::Marked(_) | Item::Refused(_) => {}
        Item::Lost(loss) => {
            let (at, topic) = (loss.at.name().to_owned(), loss.topic().to_owned());
            *lost.entry(topic.clone()).or_default() += loss.frames;
            let what = Happened::Lost { at, topic, frames: loss.frames };
            writer.keep(Message::Event(Event { at_ns: monotonic_ns(), what }));
        }
    }
}

/// Reconnects to the tap that replaces a dead one; `None` if the run has ended.
fn again(root: &Path, request: &Request, stop: &Stop) -> Option<Client> {
    let begun = Instant::now();
    while root.exists() && begun.elapsed() < RETURN_LIMIT && !stop.requested() && lives(root) {
        if let Ok(client) = Client::attach(root, request) {
            return Some(client);
        }
        std::thread::sleep(WAIT / 4);
    }
    None
}

/// Whether the run's launcher is alive.
fn lives(root: &Path) -> bool {
    ports::living_runs().is_ok_and(|runs| runs.iter().any(|run| run.root == root))
}
