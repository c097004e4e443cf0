//! The receiver of a link: it connects, confirms each frame, and connects again when the link is lost.
//!
//! A frame's age is a sum of two durations, each measured on one clock:
//!
//! 1. on the sender's clock, the time from the release of the tick to the sending of the frame;
//! 2. on the receiver's clock, the time from the sending of a confirmation to the arrival of a frame that
//!    returns its token, minus the time for which the sender has held the token. The frame's way is shorter
//!    than this round trip.
//!
//! So the age is an upper bound, and the clocks of two hosts are never compared. If the clocks are synchronised,
//! [`Link::clock_offset_ns`] makes the second part exact.

use std::io::ErrorKind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytemuck::bytes_of;
use ports::{clock_offset_ns, monotonic_ns};
use source::Inbox;

use crate::auth::{Key, Session};
use crate::counts::{Counts, LinkError};
use crate::frame::detections::{self, Detections};
use crate::frame::forecasts::{self, Forecasts};
use crate::frame::{self, Ack, Envelope, FRAME_BYTES_MAX, Kind};
use crate::greeting::{GREETING_LIMIT, answer};
use crate::socket::{Address, Socket};

/// Shortest and longest pause before a new connection.
const PAUSE_MIN: Duration = Duration::from_millis(50);
const PAUSE_MAX: Duration = Duration::from_secs(1);

/// How a receiver connects.
#[derive(Clone, Debug)]
pub struct Link {
    /// Where the sender listens.
    pub address: Address,
    /// The expected frames.
    pub kind: Kind,
    /// The key of both ends.
    pub key: Key,
    /// Longest time without a frame, after which the link is lost.
    pub timeout: Duration,
    /// Frames of a greater age are not delivered.
    pub max_age: Duration,
    /// The sender's Unix time minus this host's, if it is known, as from PTP.
    pub clock_offset_ns: Option<i64>,
}

/// The contents of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// The forecasts of a tick.
    Forecasts(Forecasts),
    /// A sensor's frame.
    Detections(Detections),
}

/// A frame that has arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// The contents.
    pub body: Body,
    /// Greatest possible age at the arrival: time since the release of the tick.
    pub age_ns: u64,
    /// Time of the arrival on this host's `CLOCK_MONOTONIC`.
    pub arrived_ns: u64,
}

/// A thread that receives frames until this value is dropped.
#[derive(Debug)]
pub struct Receiver {
    inbox: Arc<Inbox<Received>>,
    counts: Arc<Counts>,
    current: Arc<Current>,
    thread: Option<JoinHandle<()>>,
}

/// The current connection, so that another thread can end it.
#[derive(Debug, Default)]
struct Current {
    socket: Mutex<Option<Socket>>,
    is_lost: AtomicBool,
}

impl Current {
    fn replace(&self, socket: Option<Socket>) {
        // The only change is an assignment, so a panic leaves the value whole.
        let before =
            std::mem::replace(&mut *self.socket.lock().unwrap_or_else(PoisonError::into_inner), socket);
        if let Some(before) = before {
            before.abort();
        }
    }
}

impl Receiver {
    /// Starts to receive. At most `len_max` frames wait; the oldest is dropped when a further one arrives.
    ///
    /// # Errors
    /// The system's error if the thread can't be started.
    pub fn start(link: Link, len_max: usize) -> std::io::Result<Self> {
        let (inbox, counts) = (Arc::new(Inbox::new(len_max)), Arc::<Counts>::default());
        let current = Arc::<Current>::default();
        let (of_thread, counted, connection) =
            (Arc::clone(&inbox), Arc::clone(&counts), Arc::clone(&current));
        let thread = thread::Builder::new().name("bridge-receive".to_owned());
        let thread = thread.spawn(move || receive(&link, &counted, &of_thread, &connection))?;
        Ok(Self { inbox, counts, current, thread: Some(thread) })
    }

    /// Takes all frames that wait. Waits at most `timeout` for the first.
    pub fn take(&self, timeout: Duration) -> impl Iterator<Item = Received> {
        self.inbox.take(timeout).into_iter()
    }

    /// Whether there was a connection, and it is lost.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.current.is_lost.load(Ordering::Relaxed)
    }

    /// What became of the connections and frames so far.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Number of frames that were dropped before they were taken.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.inbox.dropped()
    }
}

impl Drop for Receiver {
    fn drop(&mut self) {
        self.inbox.close();
        self.current.replace(None);
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that receives has panicked");
        }
    }
}

/// Receives frames, over one connection after another, until the inbox is closed.
fn receive(link: &Link, counts: &Counts, inbox: &Inbox<Received>, current: &Current) {
    let mut pause = PAUSE_MIN;
    // The problem that was logged last: the same one is not logged again.
    let mut logged = String::new();
    while !inbox.is_closed() {
        let frames = counts.connected.get();
        let ended = connected(link, counts, inbox, current);
        current.replace(None);
        let Err(error) = ended else { return };
        if inbox.is_closed() {
            return;
        }
        counts.end(&error);
        let is_new = counts.connected.get() > frames;
        if is_new {
            current.is_lost.store(true, Ordering::Relaxed);
        }
        let problem = problem(&error);
        if is_new || problem != logged {
            tracing::warn!("{}: the link is lost: {problem}", link.address);
            logged = problem;
        }
        pause = if is_new { PAUSE_MIN } else { (pause * 2).min(PAUSE_MAX) };
        inbox.wait_closed(pause);
    }
}

fn problem(error: &LinkError) -> String {
    match error {
        LinkError::Io(error) if error.kind() == ErrorKind::UnexpectedEof => {
            "the sender has closed it (has it another key?)".to_owned()
        }
        LinkError::Io(error) if error.kind() == ErrorKind::TimedOut => "nothing arrives".to_owned(),
        _ => error.to_string(),
    }
}

/// Receives frames over one connection. Returns only if the inbox is closed.
fn connected(
    link: &Link,
    counts: &Counts,
    inbox: &Inbox<Received>,
    current: &Current,
) -> Result<(), LinkError> {
    let mut socket = Socket::connect(&link.address, GREETING_LIMIT)?;
    socket.tune(link.timeout)?;
    current.replace(Some(socket.try_clone()?));
    if inbox.is_closed() {
        return Ok(());
    }
    let session = answer(&mut socket, link.kind, &link.key, monotonic_ns())?;
    let mut bytes = Vec::with_capacity(FRAME_BYTES_MAX);
    let mut counter = 0;
    while !inbox.is_closed() {
        counter += 1;
        let (envelope, arrived_ns, body) = next(&mut socket, &session, counter, &mut bytes, link)?;
        if counter == 1 {
            counts.connected.add(1);
            current.is_lost.store(false, Ordering::Relaxed);
            tracing::info!("{}: connected", link.address);
        }
        let age_ns = age_ns(&envelope, arrived_ns, link.clock_offset_ns);
        match body {
            Some(_) if u128::from(age_ns) > link.max_age.as_nanos() => counts.old.add(1),
            Some(body) => {
                counts.frames.add(1);
                inbox.push(Received { body, age_ns, arrived_ns });
            }
            None => {}
        }
    }
    Ok(())
}

/// Reads and confirms a frame.
fn next(
    socket: &mut Socket,
    session: &Session,
    counter: u64,
    bytes: &mut Vec<u8>,
    link: &Link,
) -> Result<(Envelope, u64, Option<Body>), LinkError> {
    let until = Some(Instant::now() + link.timeout);
    let mut start = [0; Envelope::BYTES];
    socket.read_until(&mut start, until)?;
    let envelope = Envelope::read(&start)?;
    bytes.clear();
    bytes.extend_from_slice(&start);
    // At most `FRAME_BYTES_MAX`, for which there is room already.
    bytes.resize(envelope.length as usize, 0);
    socket.read_until(&mut bytes[Envelope::BYTES..], until)?;
    let arrived_ns = monotonic_ns();
    let (envelope, body) = frame::open(bytes, session, counter)?;
    let body = read(&envelope, body, link.kind)?;
    let ack = Ack { counter, token: arrived_ns };
    let mut confirmation = [0; 32];
    confirmation[..16].copy_from_slice(bytes_of(&ack));
    confirmation[16..].copy_from_slice(&session.ack_code(bytes_of(&ack)));
    socket.write_until(&confirmation, Instant::now() + link.timeout)?;
    Ok((envelope, arrived_ns, body))
}

/// The body of a frame of the expected kind; `None` if the frame only shows that the sender is alive.
fn read(envelope: &Envelope, body: &[u8], expected: Kind) -> Result<Option<Body>, LinkError> {
    let found = envelope.kind;
    Ok(match expected {
        _ if found == Kind::Alive as u16 => None,
        Kind::Forecasts if found == expected as u16 => Some(Body::Forecasts(forecasts::read(body)?)),
        Kind::Detections if found == expected as u16 => Some(Body::Detections(detections::read(body)?)),
        _ => return Err(frame::Refused::Kind { found, expected: expected as u16 }.into()),
    })
}

/// The greatest possible age of a frame.
fn age_ns(envelope: &Envelope, arrived_ns: u64, offset_ns: Option<i64>) -> u64 {
    let waited_ns = u64::from(envelope.waited_us) * 1_000;
    let way_ns = match offset_ns {
        Some(offset_ns) => {
            let arrived_unix_ns = clock_offset_ns().saturating_add_unsigned(arrived_ns);
            let sent_unix_ns = envelope.sent_unix_ns.saturating_sub(offset_ns);
            u64::try_from(arrived_unix_ns.saturating_sub(sent_unix_ns)).unwrap_or(0)
        }
        // A token of the future is not ours: the age is unknown.
        None => arrived_ns.checked_sub(envelope.token).map_or(u64::MAX, |round_ns| {
            // The microseconds are rounded down.
            round_ns.saturating_sub(u64::from(envelope.held_us) * 1_000)
        }),
    };
    waited_ns.saturating_add(way_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_age_is_a_sum_of_durations_unless_the_clocks_are_synchronised() {
        let envelope = Envelope {
            token: 1_000_000,
            held_us: 70_000,
            waited_us: 30_000,
            ..Envelope::new(Kind::Alive, 1)
        };
        assert_eq!(age_ns(&envelope, 111_000_000, None), 70_000_000);
        assert_eq!(age_ns(&envelope, 999_999, None), u64::MAX, "a token of the future");
        let now_ns = monotonic_ns();
        let sent_unix_ns = clock_offset_ns() + now_ns as i64 + 5_000_000_000 - 20_000_000;
        let envelope = Envelope { sent_unix_ns, ..envelope };
        let age_ns = |offset_ns| age_ns(&envelope, now_ns, Some(offset_ns));
        // The offset of the two clocks is read twice.
        assert!(age_ns(5_000_000_000).abs_diff(50_000_000) < 10_000_000, "{}", age_ns(5_000_000_000));
        assert_eq!(age_ns(0), 30_000_000, "a clock that is ahead");
    }
}
