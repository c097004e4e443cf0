//! The output of the stages' processes. One thread reads all pipes, so no process and no reader of the log
//! delays the supervisor.
//!
//! A stage may print without end. So the thread takes at most [`BLOCK_BYTES`] of a pipe in a turn and forwards at
//! most [`TURN_LINES_MAX`] lines of it. Further lines are discarded and counted. If a pipe had a whole block, the
//! next turn begins after [`PAUSE`]: only the process that prints too much waits in its `write`.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use wire::StageId;

use crate::text::{message, plain};

/// Number of lines kept per process, to be shown if the process dies.
const LAST_LINES_MAX: usize = 12;
/// Maximum length of a line in bytes; longer lines are split.
const LINE_BYTES_MAX: usize = 4096;
/// Bytes that are read from a pipe in a turn: the size of a full pipe.
const BLOCK_BYTES: usize = 64 << 10;
/// Most lines of a pipe that are forwarded in a turn: a full pipe of lines of 128 bytes.
const TURN_LINES_MAX: usize = 512;
/// Pause after a turn in which a pipe had a whole block.
const PAUSE: Duration = Duration::from_millis(20);
/// Interval between checks for the end of the output.
const LOOK: Duration = Duration::from_millis(1);

/// Receives the lines of the stages, in the thread that reads them. It must not wait.
pub type Sink = Box<dyn FnMut(StageId, &str) + Send>;

/// The output of all stages.
#[derive(Debug)]
pub struct StageOutput {
    shared: Arc<Shared>,
    wake: UnixStream,
}

#[derive(Debug, Default)]
struct Shared {
    /// Pipes that the thread has not taken over yet.
    new: Mutex<Vec<Pipe>>,
    /// Number of pipes that are open.
    open: AtomicUsize,
    /// Numbers of lines that were discarded here.
    lost: Mutex<BTreeMap<StageId, u64>>,
    is_over: AtomicBool,
}

/// A pipe from a process.
#[derive(Debug)]
struct Pipe {
    stage: StageId,
    file: File,
    /// The beginning of a line.
    begun: Vec<u8>,
    tail: Arc<Tail>,
}

/// The end of a process's output. When it is dropped, the pipes are closed, even if another process writes to
/// them.
#[derive(Debug)]
pub struct Output {
    tail: Arc<Tail>,
    wake: UnixStream,
}

#[derive(Debug, Default)]
struct Tail {
    /// The last lines as they were printed.
    lines: Mutex<VecDeque<Vec<u8>>>,
    /// Number of open pipes.
    open: AtomicUsize,
    is_dropped: AtomicBool,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl StageOutput {
    /// Starts the thread. It ends when the value is dropped.
    ///
    /// # Errors
    /// The system's error if the thread can't be started.
    pub fn open(sink: Sink) -> io::Result<Self> {
        let (wake, woken) = UnixStream::pair()?;
        wake.set_nonblocking(true)?;
        woken.set_nonblocking(true)?;
        let shared = Arc::new(Shared::default());
        let own = shared.clone();
        std::thread::Builder::new()
            .name("stage output".to_owned())
            .spawn(move || own.forward(&woken, sink))?;
        Ok(Self { shared, wake })
    }

    /// Reads the pipes of a process from now on.
    ///
    /// # Errors
    /// The system's error.
    pub fn add(&self, stage: StageId, pipes: impl IntoIterator<Item = OwnedFd>) -> io::Result<Output> {
        let tail = Arc::new(Tail::default());
        for pipe in pipes {
            fcntl_setfl(&pipe, fcntl_getfl(&pipe)? | OFlags::NONBLOCK)?;
            tail.open.fetch_add(1, Ordering::AcqRel);
            self.shared.open.fetch_add(1, Ordering::AcqRel);
            let pipe = Pipe { stage, file: pipe.into(), begun: Vec::new(), tail: tail.clone() };
            locked(&self.shared.new).push(pipe);
        }
        wake(&self.wake);
        Ok(Output { tail, wake: self.wake.try_clone()? })
    }

    /// Numbers of lines that were discarded because their stages printed too many at once.
    pub fn lost(&self) -> BTreeMap<StageId, u64> {
        locked(&self.shared.lost).clone()
    }

    /// Waits until all pipes are closed and read, but at most `limit`.
    pub fn finish(&self, limit: Duration) {
        wait_for(limit, || self.shared.open.load(Ordering::Acquire) == 0);
    }
}

impl Drop for StageOutput {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Release);
        wake(&self.wake);
    }
}

impl Output {
    /// Returns the last lines of the process. Waits for the end of its output, but at most `limit`: another
    /// process may hold the pipes open.
    pub fn last_lines(&self, limit: Duration) -> Vec<String> {
        wait_for(limit, || self.tail.open.load(Ordering::Acquire) == 0);
        locked(&self.tail.lines).iter().map(|line| message(&text_of(line))).collect()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        self.tail.is_dropped.store(true, Ordering::Release);
        wake(&self.wake);
    }
}

/// Wakes the thread. A full socket wakes it, too.
fn wake(mut socket: &UnixStream) {
    let _ = socket.write(&[0]);
}

fn wait_for(limit: Duration, is_met: impl Fn() -> bool) {
    let begun = Instant::now();
    while !is_met() && begun.elapsed() < limit {
        std::thread::sleep(LOOK);
    }
}

fn text_of(line: &[u8]) -> String {
    plain(String::from_utf8_lossy(line).trim_end()).into_owned()
}

impl Shared {
    fn forward(&self, mut woken: &UnixStream, mut sink: Sink) {
        let mut pipes: Vec<Pipe> = Vec::new();
        let mut block = vec![0; BLOCK_BYTES];
        while !self.is_over.load(Ordering::Acquire) {
            pipes.append(&mut locked(&self.new));
            let mut ready: Vec<PollFd<'_>> =
                pipes.iter().map(|pipe| PollFd::from_borrowed_fd(pipe.file.as_fd(), PollFlags::IN)).collect();
            ready.push(PollFd::new(woken, PollFlags::IN));
            if poll(&mut ready, None).is_err() {
                continue;
            }
            let is_ready: Vec<bool> = ready.iter().map(|of| !of.revents().is_empty()).collect();
            drop(ready);
            if is_ready.last() == Some(&true) {
                let _ = woken.read(&mut block);
            }
            let (mut place, mut is_flooded) = (0, false);
            pipes.retain_mut(|pipe| {
                let read = match is_ready[place] {
                    true => pipe.file.read(&mut block),
                    false => Err(ErrorKind::WouldBlock.into()),
                };
                place += 1;
                let is_open = match read {
                    Ok(len) if len > 0 => {
                        is_flooded |= len == BLOCK_BYTES;
                        let lost = pipe.take(&block[..len], &mut sink);
                        if lost > 0 {
                            *locked(&self.lost).entry(pipe.stage).or_default() += lost;
                        }
                        true
                    }
                    Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
                    Ok(_) => false,
                };
                let is_kept = is_open && !pipe.tail.is_dropped.load(Ordering::Acquire);
                if !is_kept {
                    pipe.end(&mut sink);
                    self.open.fetch_sub(1, Ordering::AcqRel);
                }
                is_kept
            });
            if is_flooded {
                std::thread::sleep(PAUSE);
            }
        }
    }
}

impl Pipe {
    /// Forwards the lines of a block. Returns the number of discarded ones.
    fn take(&mut self, mut block: &[u8], sink: &mut Sink) -> u64 {
        let mut lines = locked(&self.tail.lines);
        let mut count = 0;
        while !block.is_empty() {
            let room = LINE_BYTES_MAX - self.begun.len();
            let end = block.iter().take(room).position(|&byte| byte == b'\n');
            let (line, rest) = block.split_at(end.map_or(room.min(block.len()), |end| end + 1));
            self.begun.extend_from_slice(line);
            block = rest;
            if end.is_none() && self.begun.len() < LINE_BYTES_MAX {
                break;
            }
            if count < TURN_LINES_MAX {
                sink(self.stage, &text_of(&self.begun));
            }
            count += 1;
            keep(&mut lines, &self.begun);
            self.begun.clear();
        }
        count.saturating_sub(TURN_LINES_MAX) as u64
    }

    /// Forwards a last line without a line end.
    fn end(&mut self, sink: &mut Sink) {
        if !self.begun.is_empty() {
            sink(self.stage, &text_of(&self.begun));
            keep(&mut locked(&self.tail.lines), &self.begun);
        }
        self.tail.open.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Keeps a line in place of the oldest one.
fn keep(lines: &mut VecDeque<Vec<u8>>, line: &[u8]) {
    let mut kept = if lines.len() == LAST_LINES_MAX { lines.pop_front() } else { None }.unwrap_or_default();
    kept.clear();
    kept.extend_from_slice(line);
    lines.push_back(kept);
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, sync_channel};

    use super::*;

    const LIMIT: Duration = Duration::from_secs(60);

    /// A process's pipe, its output, and what is forwarded of it.
    fn begin() -> (io::PipeWriter, StageOutput, Output, Receiver<String>) {
        let (reader, writer) = io::pipe().unwrap();
        let (sender, lines) = sync_channel(100_000);
        let stages =
            StageOutput::open(Box::new(move |_, line| sender.send(line.to_owned()).unwrap())).unwrap();
        let output = stages.add(StageId::Decoder, [reader.into()]).unwrap();
        (writer, stages, output, lines)
    }

    #[test]
    fn lines_are_forwarded_and_the_last_ones_are_kept() {
        let (mut writer, stages, output, lines) = begin();
        writer.write_all(b"\x1b[31mone\x1b[0m\ntwo\nthr").unwrap();
        writer.write_all(b"ee").unwrap();
        drop(writer);
        assert_eq!(output.last_lines(LIMIT), ["one", "two", "three"]);
        drop((stages, output));
        assert_eq!(lines.iter().collect::<Vec<_>>(), ["one", "two", "three"]);
    }

    #[test]
    fn a_flood_is_counted_and_a_line_without_end_is_split() {
        let (mut writer, stages, output, lines) = begin();
        let flood = "y\n".repeat(100_000);
        writer.write_all(flood.as_bytes()).unwrap();
        writer.write_all(&[b'x'; 3 * LINE_BYTES_MAX + 1]).unwrap();
        drop(writer);
        let last = output.last_lines(LIMIT);
        assert_eq!(last.len(), LAST_LINES_MAX);
        assert_eq!(last.last().map(String::len), Some(1));
        assert_eq!(last[LAST_LINES_MAX - 2].len(), LINE_BYTES_MAX);
        let lost = stages.lost()[&StageId::Decoder];
        drop((stages, output));
        let forwarded = lines.iter().count() as u64;
        assert!(lost > 0 && forwarded + lost == 100_004, "{forwarded} forwarded, {lost} lost");
    }

    #[test]
    fn a_process_that_outlives_its_stage_can_no_longer_print() {
        let (mut writer, stages, output, _lines) = begin();
        writer.write_all(b"one\n").unwrap();
        assert!(output.last_lines(Duration::from_millis(50)).len() <= 1, "the pipe is still open");
        drop(output);
        stages.finish(LIMIT);
        assert_eq!(writer.write_all(b"two\n").unwrap_err().kind(), ErrorKind::BrokenPipe);
    }
}
