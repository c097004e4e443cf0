//! The sender of a link: it listens, and sends the newest frame to each receiver.
//!
//! [`Sender::send`] never waits for a receiver. It replaces the newest frame, and a thread for each receiver
//! sends it as soon as fewer than [`WINDOW`] frames wait for their confirmation. A frame that was replaced
//! before is skipped, and counted. A receiver that does not confirm a frame within the time limit is dropped,
//! together with the bytes that the kernel still holds for it.

use std::collections::VecDeque;
use std::io;
use std::net::IpAddr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use bytemuck::{Zeroable as _, bytes_of, bytes_of_mut};
use ports::{clock_offset_ns, monotonic_ns};

use crate::auth::{CODE_BYTES, Key, Session, is_equal};
use crate::counts::{Counts, LinkError};
use crate::frame::{self, Ack, Envelope, FRAME_BYTES_MAX, Kind, Refused};
use crate::greeting::{Greeted, greet};
use crate::socket::{Address, Listener, Socket};

/// Most receivers of a sender.
pub const RECEIVERS_MAX: usize = 4;
/// Most connections that have not been authenticated yet. The oldest one yields to a further one.
pub const GREETINGS_MAX: usize = 16;
/// The same for the connections of one address, so that another address keeps places.
pub const GREETINGS_OF_SOURCE_MAX: usize = 4;
/// Most frames of a link that wait for their confirmation. Two use a link whose round trip is longer than a
/// tick; each further one would be a backlog.
pub const WINDOW: usize = 2;

/// Keeps the link alive this many times within the time limit.
const ALIVE_SHARE: u32 = 4;
/// Pause after a failed accept, for instance if descriptors run out.
const PAUSE: Duration = Duration::from_millis(100);

/// Sends frames to all receivers.
#[derive(Debug)]
pub struct Sender {
    shared: Arc<Shared>,
    address: Address,
    scratch: Vec<u8>,
}

/// What all threads of a sender share.
#[derive(Debug)]
struct Shared {
    listener: Listener,
    kind: Kind,
    key: Key,
    timeout: Duration,
    counts: Counts,
    newest: Mutex<Newest>,
    changed: Condvar,
    receivers: AtomicUsize,
    /// The connections that have not been authenticated yet, oldest first.
    greetings: Mutex<VecDeque<Arc<Greeting>>>,
}

/// A connection that has not been authenticated yet.
#[derive(Debug)]
struct Greeting {
    source: Option<IpAddr>,
    socket: Socket,
}

/// The newest frame.
#[derive(Debug)]
struct Newest {
    body: Vec<u8>,
    /// Number of frames so far.
    number: u64,
    released_ns: u64,
    is_closed: bool,
}

/// What a receiver has confirmed.
#[derive(Clone, Copy, Debug)]
struct Acked {
    /// Number of the newest frame that was sent.
    sent: u64,
    /// Number of the newest frame that was confirmed.
    counter: u64,
    token: u64,
    arrived: Instant,
    is_gone: bool,
}

impl Sender {
    /// Listens for receivers.
    ///
    /// # Errors
    /// The system's error if the address can't be used.
    pub fn listen(address: &Address, kind: Kind, key: Key, timeout: Duration) -> io::Result<Self> {
        let listener = Listener::open(address)?;
        let address = listener.address()?;
        let newest = Newest { body: body(), number: 0, released_ns: 0, is_closed: false };
        let shared = Arc::new(Shared {
            listener,
            kind,
            key,
            timeout,
            counts: Counts::default(),
            newest: Mutex::new(newest),
            changed: Condvar::new(),
            receivers: AtomicUsize::new(0),
            greetings: Mutex::default(),
        });
        let of_thread = Arc::clone(&shared);
        thread::Builder::new().name("bridge-accept".to_owned()).spawn(move || accept(&of_thread))?;
        Ok(Self { shared, address, scratch: body() })
    }

    /// Where it listens.
    #[must_use]
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// What became of the connections and frames so far.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.shared.counts
    }

    /// Number of connected receivers.
    #[must_use]
    pub fn receivers(&self) -> usize {
        self.shared.receivers.load(Ordering::Relaxed)
    }

    /// Replaces the newest frame by the body that `write` fills. The tick was released at `released_ns` on
    /// `CLOCK_MONOTONIC`.
    pub fn send(&mut self, released_ns: u64, write: impl FnOnce(&mut Vec<u8>)) {
        write(&mut self.scratch);
        let mut newest = self.shared.newest();
        std::mem::swap(&mut newest.body, &mut self.scratch);
        newest.released_ns = released_ns;
        newest.number += 1;
        drop(newest);
        self.shared.changed.notify_all();
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        self.shared.newest().is_closed = true;
        self.shared.changed.notify_all();
        self.shared.listener.close();
    }
}

fn body() -> Vec<u8> {
    Vec::with_capacity(FRAME_BYTES_MAX)
}

impl Shared {
    fn newest(&self) -> MutexGuard<'_, Newest> {
        // Every change is whole before a panic can happen.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn greetings(&self) -> MutexGuard<'_, VecDeque<Arc<Greeting>>> {
        // As above.
        self.greetings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives a connection a place until it is authenticated. If there is none, the oldest connection of the same
    /// address ends, or else the oldest one.
    fn begin_greeting(&self, socket: &Socket) -> io::Result<Arc<Greeting>> {
        let greeting = Arc::new(Greeting { source: socket.source(), socket: socket.try_clone()? });
        let mut greetings = self.greetings();
        let is_same = |other: &Arc<Greeting>| other.source == greeting.source;
        let of_source = greetings.iter().filter(|other| is_same(other)).count();
        let yields = match of_source >= GREETINGS_OF_SOURCE_MAX {
            true => greetings.iter().position(is_same),
            false => (greetings.len() >= GREETINGS_MAX).then_some(0),
        };
        if let Some(oldest) = yields.and_then(|place| greetings.remove(place)) {
            oldest.socket.abort();
            self.counts.end(&LinkError::Full);
        }
        greetings.push_back(Arc::clone(&greeting));
        Ok(greeting)
    }

    fn end_greeting(&self, greeting: &Arc<Greeting>) {
        self.greetings().retain(|other| !Arc::ptr_eq(other, greeting));
    }
}

/// One of a limited number of places.
struct Place<'a>(&'a AtomicUsize);

impl<'a> Place<'a> {
    fn take(taken: &'a AtomicUsize, most: usize) -> Option<Self> {
        let place = Self(taken);
        // Dropping the place gives it back, even if it was one too many.
        (taken.fetch_add(1, Ordering::AcqRel) < most).then_some(place)
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Accepts connections until the sender is dropped.
fn accept(shared: &Arc<Shared>) {
    while !shared.newest().is_closed {
        let socket = match shared.listener.accept() {
            Ok(socket) => socket,
            // Another user must not delay the receivers of this one.
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                shared.counts.end(&error.into());
                continue;
            }
            Err(_) => {
                if !shared.newest().is_closed {
                    thread::sleep(PAUSE);
                }
                continue;
            }
        };
        let Ok(greeting) = shared.begin_greeting(&socket) else {
            shared.counts.end(&LinkError::Full);
            continue;
        };
        let (of_thread, of_connection) = (Arc::clone(shared), Arc::clone(&greeting));
        let thread = thread::Builder::new().name("bridge-send".to_owned());
        if thread.spawn(move || serve(socket, &of_connection, &of_thread)).is_err() {
            shared.end_greeting(&greeting);
            shared.counts.end(&LinkError::Full);
        }
    }
}

/// Serves a connection until it ends.
fn serve(mut socket: Socket, greeting: &Arc<Greeting>, shared: &Arc<Shared>) {
    let greeted = greet(&mut socket, shared.kind, &shared.key);
    shared.end_greeting(greeting);
    let place = Place::take(&shared.receivers, RECEIVERS_MAX);
    let ended = match (greeted, &place) {
        (Ok(_), None) => Err(LinkError::Full),
        (Ok(greeted), Some(_)) => {
            shared.counts.connected.add(1);
            follow(&mut socket, greeted, shared)
        }
        (Err(error), _) => Err(error),
    };
    socket.abort();
    if let Err(error) = ended {
        shared.counts.end(&error);
        tracing::debug!("a receiver is dropped: {error}");
    }
}

/// Sends frames while another thread reads the confirmations.
fn follow(socket: &mut Socket, greeted: Greeted, shared: &Arc<Shared>) -> Result<(), LinkError> {
    let Greeted { session, token, arrived } = greeted;
    socket.tune(shared.timeout)?;
    let acked = Mutex::new(Acked { sent: 0, counter: 0, token, arrived, is_gone: false });
    let mut back = socket.try_clone()?;
    thread::scope(|scope| {
        let listening = scope.spawn(|| {
            let ended = listen(&mut back, &session, &acked, shared);
            lock(&acked).is_gone = true;
            // Under the lock, so that the other thread is not between its look and its sleep.
            drop(shared.newest());
            shared.changed.notify_all();
            ended
        });
        let ended = send(socket, &session, &acked, shared);
        socket.abort();
        // Only the first of the two errors is the cause.
        match (ended, listening.join()) {
            (Ok(Ended::Gone), Ok(ended)) => ended,
            (Ok(Ended::Closed), _) => Ok(()),
            (Ok(Ended::Gone), Err(_)) => Err(io::Error::other("a thread has panicked").into()),
            (Err(error), _) => Err(error),
        }
    })
}

fn lock(acked: &Mutex<Acked>) -> MutexGuard<'_, Acked> {
    acked.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads confirmations until the connection ends.
fn listen(
    socket: &mut Socket,
    session: &Session,
    acked: &Mutex<Acked>,
    shared: &Shared,
) -> Result<(), LinkError> {
    loop {
        let (mut ack, mut code) = (Ack::zeroed(), [0; CODE_BYTES]);
        socket.read_until(bytes_of_mut(&mut ack), None)?;
        socket.read_until(&mut code, None)?;
        if !is_equal(&code, &session.ack_code(bytes_of(&ack))) {
            return Err(Refused::Code.into());
        }
        let mut acked = lock(acked);
        let expected = acked.counter + 1;
        if ack.counter != expected || expected > acked.sent {
            return Err(Refused::Counter { found: ack.counter, expected }.into());
        }
        (acked.counter, acked.token, acked.arrived) = (ack.counter, ack.token, Instant::now());
        drop(acked);
        drop(shared.newest());
        shared.changed.notify_all();
    }
}

/// Why no frame follows.
enum Ended {
    /// The sender is dropped.
    Closed,
    /// The connection has ended.
    Gone,
}

/// The work that is due.
enum Due {
    /// A frame: its body is copied, with the time of its release.
    Frame(u64),
    /// A frame without a body.
    Alive,
    Ended(Ended),
}

fn send(
    socket: &mut Socket,
    session: &Session,
    acked: &Mutex<Acked>,
    shared: &Shared,
) -> Result<Ended, LinkError> {
    let mut bytes = body();
    let mut body = body();
    let mut line = Line::new(shared);
    loop {
        let (mut envelope, waited_ns) = match line.next(&mut body, acked, shared)? {
            Due::Ended(ended) => return Ok(ended),
            Due::Frame(released_ns) => {
                (Envelope::new(shared.kind, line.counter), monotonic_ns().saturating_sub(released_ns))
            }
            Due::Alive => (Envelope::new(Kind::Alive, line.counter), 0),
        };
        let Acked { token, arrived, .. } = {
            let mut acked = lock(acked);
            acked.sent = line.counter;
            *acked
        };
        envelope.token = token;
        envelope.held_us = u32::try_from(arrived.elapsed().as_micros()).unwrap_or(u32::MAX);
        envelope.waited_us = u32::try_from(waited_ns / 1_000).unwrap_or(u32::MAX);
        envelope.sent_unix_ns = clock_offset_ns().saturating_add_unsigned(monotonic_ns());
        let is_alive = envelope.kind == Kind::Alive as u16;
        frame::begin(&mut bytes, &envelope, if is_alive { &[] } else { &body });
        frame::seal(&mut bytes, session);
        socket.write_until(&bytes, Instant::now() + shared.timeout)?;
        shared.counts.frames.add(u64::from(!is_alive));
    }
}

/// The order of frames to one receiver.
struct Line {
    /// Number of the newest frame of the session.
    counter: u64,
    /// Number of the newest frame of the sender.
    number: u64,
    /// When the newest frames were sent.
    sent: [Instant; WINDOW],
    timeout: Duration,
}

impl Line {
    /// Frames of the past are not sent. The first frame has no body, and goes out at once: it authenticates the
    /// sender.
    fn new(shared: &Shared) -> Self {
        let (now, timeout) = (Instant::now(), shared.timeout);
        Self { counter: 0, number: shared.newest().number, sent: [now; WINDOW], timeout }
    }

    /// Waits for the next work. A frame is copied to `body`, and its number in the session is taken.
    fn next(&mut self, body: &mut Vec<u8>, acked: &Mutex<Acked>, shared: &Shared) -> Result<Due, LinkError> {
        let mut newest = shared.newest();
        loop {
            let confirmed = *lock(acked);
            if newest.is_closed {
                return Ok(Due::Ended(Ended::Closed));
            }
            if confirmed.is_gone {
                return Ok(Due::Ended(Ended::Gone));
            }
            let now = Instant::now();
            let waiting = self.counter - confirmed.counter;
            let place = |number: u64| (number % WINDOW as u64) as usize;
            let limit = self.sent[place(confirmed.counter + 1)] + self.timeout;
            if waiting > 0 && now >= limit {
                return Err(LinkError::Slow);
            }
            let has_room = waiting < WINDOW as u64;
            let alive = self.sent[place(self.counter)] + self.timeout / ALIVE_SHARE;
            let is_newer = newest.number > self.number;
            if has_room && (is_newer || now >= alive || self.counter == 0) {
                self.counter += 1;
                self.sent[place(self.counter)] = now;
                if !is_newer {
                    return Ok(Due::Alive);
                }
                shared.counts.skipped.add(newest.number - self.number - 1);
                self.number = newest.number;
                body.clear();
                body.extend_from_slice(&newest.body);
                return Ok(Due::Frame(newest.released_ns));
            }
            let until = match (waiting > 0, has_room) {
                (true, true) => limit.min(alive),
                (true, false) => limit,
                (false, _) => alive,
            };
            let wait = until.saturating_duration_since(now);
            newest = shared.changed.wait_timeout(newest, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
