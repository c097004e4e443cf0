//! Output that never makes its sender wait: a bounded queue, and a thread that writes.
//!
//! A pipe that nobody reads, a terminal after Ctrl-S or a slow disk blocks `write` for any time. The supervisor
//! must restart stages meanwhile, so it only puts pieces into a queue. Each origin has its own share of the
//! queue. So a stage that prints without end displaces no line of another stage. A piece that has no room is
//! discarded and counted.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, ErrorKind, Write};
use std::mem::take;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use wire::StageId;

/// Most bytes of one origin that wait for the log or for the terminal.
pub const BYTES_MAX: usize = 256 << 10;
/// Most pieces of one origin that wait. A line of the log is one piece.
pub const PIECES_MAX: usize = 1024;
/// Pause before another try, if the file is non-blocking and has no room. Another program may have set this.
const PAUSE: Duration = Duration::from_millis(10);

/// Whose output a piece is: a stage's, or `None` for the launcher's.
pub type Origin = Option<StageId>;

/// Pieces of output that wait.
#[derive(Debug)]
pub struct Queue {
    bytes_max: usize,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    pieces: VecDeque<(Origin, Vec<u8>)>,
    /// Number of waiting pieces and their bytes, by origin.
    waiting: BTreeMap<Origin, (usize, usize)>,
    lost: BTreeMap<Origin, u64>,
    is_writing: bool,
    is_closed: bool,
    /// The first error of the file.
    error: Option<io::Error>,
}

impl Queue {
    /// Creates an empty queue with room for this many bytes of each origin.
    pub const fn new(bytes_max: usize) -> Self {
        let state = State {
            pieces: VecDeque::new(),
            waiting: BTreeMap::new(),
            lost: BTreeMap::new(),
            is_writing: false,
            is_closed: false,
            error: None,
        };
        Self { bytes_max, state: Mutex::new(state), changed: Condvar::new() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a piece. Returns false if it has no room and is discarded. An origin without waiting pieces may add
    /// a piece of any size.
    pub fn push(&self, origin: Origin, piece: Vec<u8>) -> bool {
        let mut state = self.state();
        let (pieces, bytes) = state.waiting.get(&origin).copied().unwrap_or_default();
        let has_room = pieces == 0 || (pieces < PIECES_MAX && bytes + piece.len() <= self.bytes_max);
        if !has_room || state.is_closed {
            *state.lost.entry(origin).or_default() += 1;
            return false;
        }
        state.waiting.insert(origin, (pieces + 1, bytes + piece.len()));
        state.pieces.push_back((origin, piece));
        self.changed.notify_all();
        true
    }

    /// Hands all pieces to `accept`. They stay in the queue if it returns false.
    pub fn offer(&self, accept: impl FnOnce(&[u8]) -> bool) {
        let mut state = self.state();
        if state.pieces.is_empty() {
            return;
        }
        let all = state.pieces.iter().flat_map(|(_, piece)| piece).copied().collect::<Vec<u8>>();
        if accept(&all) {
            state.pieces.clear();
            state.waiting.clear();
        }
    }

    /// Numbers of discarded pieces, by origin.
    pub fn lost(&self) -> BTreeMap<Origin, u64> {
        self.state().lost.clone()
    }
}

/// A queue in front of a file, with the thread that writes the file.
#[derive(Clone, Debug)]
pub struct Outlet(Arc<Queue>);

impl Outlet {
    /// Starts the thread. It ends once the outlet is closed and all pieces are written.
    ///
    /// # Errors
    /// The system's error if the thread can't be started.
    pub fn open(name: &str, bytes_max: usize, file: impl Write + Send + 'static) -> io::Result<Self> {
        let queue = Arc::new(Queue::new(bytes_max));
        let own = queue.clone();
        std::thread::Builder::new().name(name.to_owned()).spawn(move || own.write_to(file))?;
        Ok(Self(queue))
    }

    /// Adds a piece. Returns false if it has no room and is discarded.
    pub fn push(&self, origin: Origin, piece: Vec<u8>) -> bool {
        self.0.push(origin, piece)
    }

    /// Numbers of pieces that were discarded or could not be written, by origin.
    pub fn lost(&self) -> BTreeMap<Origin, u64> {
        self.0.lost()
    }

    /// Waits until all pieces are written, but at most `limit`. Returns whether they are.
    pub fn flush(&self, limit: Duration) -> bool {
        let until = Instant::now() + limit;
        let mut state = self.0.state();
        while !state.pieces.is_empty() || state.is_writing {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            state = self.0.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// Accepts no further piece. The thread writes the waiting pieces, closes the file and ends.
    pub fn close(&self) {
        self.0.state().is_closed = true;
        self.0.changed.notify_all();
    }

    /// Closes the file after its last piece.
    ///
    /// # Errors
    /// The first error of the file, or [`ErrorKind::TimedOut`] if pieces still wait after `limit`.
    pub fn finish(self, limit: Duration) -> io::Result<()> {
        self.close();
        let is_written = self.flush(limit);
        match self.0.state().error.take() {
            Some(error) => Err(error),
            None if is_written => Ok(()),
            None => Err(io::Error::new(
                ErrorKind::TimedOut,
                format!("its last data were not written within {} s", limit.as_secs_f64()),
            )),
        }
    }
}

impl Queue {
    /// Writes the pieces until the queue is closed and empty.
    fn write_to(&self, mut file: impl Write) {
        loop {
            let pieces = {
                let mut state = self.state();
                state.is_writing = false;
                self.changed.notify_all();
                while state.pieces.is_empty() {
                    if state.is_closed {
                        return;
                    }
                    state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
                state.is_writing = true;
                state.waiting.clear();
                take(&mut state.pieces)
            };
            for (origin, piece) in pieces {
                if let Err(error) = write_whole(&mut file, &piece) {
                    let mut state = self.state();
                    *state.lost.entry(origin).or_default() += 1;
                    state.error.get_or_insert(error);
                }
            }
        }
    }
}

fn write_whole(file: &mut impl Write, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match file.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(len) => bytes = &bytes[len..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(PAUSE),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;
    use std::os::unix::net::UnixStream;

    use super::*;

    const STAGE: Origin = Some(StageId::Decoder);

    #[test]
    fn a_full_pipe_delays_nobody_and_each_origin_has_its_own_room() {
        let (near, mut far) = UnixStream::pair().unwrap();
        let outlet = Outlet::open("test", 10_000, near).unwrap();
        // The thread waits for a reader with this piece, so the next ones stay in the queue.
        assert!(outlet.push(None, vec![b'a'; 1 << 20]));
        while !outlet.0.state().is_writing {
            std::thread::yield_now();
        }
        let accepted = (0..30).filter(|_| outlet.push(STAGE, vec![b'b'; 1_000])).count();
        assert_eq!((accepted, outlet.lost()[&STAGE]), (10, 20));
        assert!(outlet.push(None, b"c".to_vec()), "the stage has not used the launcher's room");
        assert!(!outlet.flush(Duration::from_millis(20)), "nobody reads");
        let reader = std::thread::spawn(move || {
            let mut all = Vec::new();
            far.read_to_end(&mut all).map(|_| all)
        });
        outlet.finish(Duration::from_secs(60)).unwrap();
        let all = reader.join().unwrap().unwrap();
        assert_eq!(all.len(), (1 << 20) + 10_001);
        assert!(all.ends_with(b"bc"), "the order is kept");
    }

    #[test]
    fn a_queue_has_a_limit_of_pieces_and_takes_one_piece_of_any_size() {
        let queue = Queue::new(100);
        assert!(queue.push(STAGE, vec![0; 1_000]) && !queue.push(STAGE, Vec::new()));
        let accepted = (0..2 * PIECES_MAX).filter(|_| queue.push(None, Vec::new())).count();
        assert_eq!((accepted, queue.lost()[&None]), (PIECES_MAX, PIECES_MAX as u64));
        queue.offer(|_| false);
        assert!(!queue.push(None, Vec::new()), "nothing was taken");
        queue.offer(|all| all.len() == 1_000);
        assert!(queue.push(None, Vec::new()));
    }

    #[test]
    fn a_full_disk_is_an_error_at_the_end_and_its_pieces_are_counted() {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let outlet = Outlet::open("test", 100, full).unwrap();
        assert!(outlet.push(STAGE, b"line\n".to_vec()));
        assert!(outlet.flush(Duration::from_secs(60)));
        assert_eq!(outlet.lost()[&STAGE], 1);
        let error = outlet.finish(Duration::from_secs(60)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
    }
}
