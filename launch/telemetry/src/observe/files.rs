//! Files written during a run by separate threads, so a slow disk does not delay supervision.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use console::failure::Failure;
use recorder::WholeFile;
use supervisor::Outlet;

use super::server::{Asked, Question, ask_launcher};

/// Interval between updates of the metrics file.
const METRICS_INTERVAL: Duration = Duration::from_secs(1);
/// Bytes of a trace written at a time.
const BLOCK_BYTES: usize = 64 << 10;
/// Bytes of a trace that may wait for the disk; further blocks are lost.
const WAITING_MAX: usize = 64 * BLOCK_BYTES;
/// Time for a disk to take the last data of a file.
const END_LIMIT: Duration = Duration::from_secs(2);

/// The metrics file, whose content is always complete.
#[derive(Debug)]
pub struct MetricsFile {
    path: PathBuf,
    /// Takes the last content, which ends the thread.
    last: SyncSender<String>,
    written: Receiver<Result<(), Failure>>,
}

impl MetricsFile {
    /// Starts writing the file once a second.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be written.
    pub fn begin(path: &Path, ask: SyncSender<Asked>) -> Result<Self, Failure> {
        write_whole(path, "")?;
        let (last, last_content) = sync_channel::<String>(1);
        let (is_written, written) = sync_channel(1);
        let own = path.to_owned();
        let follow = move || {
            let mut is_told = false;
            loop {
                match last_content.recv_timeout(METRICS_INTERVAL) {
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                    Ok(text) => return drop(is_written.send(write_whole(&own, &text))),
                }
                let Some(text) = ask_launcher(Question::Metrics, &ask) else { continue };
                // The run does not depend on this file, and the disk may have space again later.
                if let Err(failure) = write_whole(&own, &text)
                    && !std::mem::replace(&mut is_told, true)
                {
                    tracing::warn!("the metrics are not written: {failure}");
                }
            }
        };
        let thread = std::thread::Builder::new().name("metrics file".to_owned()).spawn(follow);
        thread.map_err(Failure::unavailable)?;
        Ok(Self { path: path.to_owned(), last, written })
    }

    /// Writes the last content.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be written.
    pub fn finish(self, text: String) -> Result<(), Failure> {
        let _ = self.last.try_send(text);
        let slow = |_| Err(Failure::file(&self.path, io::Error::from(ErrorKind::TimedOut)));
        self.written.recv_timeout(END_LIMIT).unwrap_or_else(slow)
    }
}

fn write_whole(path: &Path, text: &str) -> Result<(), Failure> {
    let write = || {
        let mut file = WholeFile::create(path)?;
        file.write_all(text.as_bytes())?;
        file.finish()
    };
    write().map_err(|error| Failure::file(path, error))
}

/// The trace file. It is readable up to its current end.
#[derive(Debug)]
pub struct TraceFile {
    path: PathBuf,
    block: Vec<u8>,
    blocks: Outlet,
    lost_bytes: u64,
}

/// A file that takes nothing after its first error, so that it has no gap.
struct UntilError(Option<File>);

impl Write for UntilError {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written =
            self.0.as_mut().map_or_else(|| Err(ErrorKind::BrokenPipe.into()), |file| file.write(bytes));
        if written.as_ref().is_err_and(|error| error.kind() != ErrorKind::Interrupted) {
            self.0 = None;
        }
        written
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TraceFile {
    /// Creates the file.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be created.
    pub fn begin(path: &Path) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| Failure::file(path, error))?;
        let blocks =
            Outlet::open("trace file", WAITING_MAX, UntilError(Some(file))).map_err(Failure::unavailable)?;
        Ok(Self { path: path.to_owned(), block: Vec::new(), blocks, lost_bytes: 0 })
    }

    /// Appends whole packets.
    pub fn write(&mut self, packets: Vec<u8>) {
        if self.block.is_empty() {
            self.block = packets;
        } else {
            self.block.extend(packets);
        }
        if self.block.len() >= BLOCK_BYTES {
            self.send();
        }
    }

    fn send(&mut self) {
        let block = std::mem::take(&mut self.block);
        let len = block.len() as u64;
        if !self.blocks.push(None, block) {
            self.lost_bytes += len;
        }
    }

    /// Writes the remaining packets.
    ///
    /// # Errors
    /// [`Failure::Data`] if the file could not be written, or the disk was slower than the trace.
    pub fn finish(mut self) -> Result<(), Failure> {
        self.send();
        self.blocks.finish(END_LIMIT).map_err(|error| Failure::file(&self.path, error))?;
        match self.lost_bytes {
            0 => Ok(()),
            lost => {
                let why = format!("the disk was too slow for {lost} bytes of the trace, which are missing");
                Err(Failure::file(&self.path, std::io::Error::other(why)))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("stgdat_observe_{name}_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_trace_file_has_all_blocks_in_order() {
        let folder = folder("trace");
        let path = folder.join("a.trace");
        let mut file = TraceFile::begin(&path).unwrap();
        let expected: Vec<u8> = (0..=255).cycle().take(3 * BLOCK_BYTES + 77).collect();
        expected.chunks(1_000).for_each(|part| file.write(part.to_vec()));
        file.finish().unwrap();
        assert!(std::fs::read(&path).unwrap() == expected);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_full_disk_is_an_error_at_the_end() {
        let mut file = TraceFile::begin(Path::new("/dev/full")).unwrap();
        file.write(vec![1; 10]);
        assert!(file.finish().is_err_and(|failure| failure.to_string().contains("/dev/full")));
        assert!(TraceFile::begin(Path::new("/no/such/folder/a")).is_err());
    }

    #[test]
    fn the_metrics_file_is_always_whole() {
        let folder = folder("metrics");
        let path = folder.join("a.prom");
        let (ask, _questions) = sync_channel(1);
        let file = MetricsFile::begin(&path, ask.clone()).unwrap();
        file.finish("stgdat_linked 1\n".to_owned()).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "stgdat_linked 1\n");
        assert!(MetricsFile::begin(&folder.join("no/such.prom"), ask).is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
