//! Files written during a run by separate threads, so a slow disk does not delay supervision.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use recorder::WholeFile;

use super::server::{Asked, Question, ask_launcher};
use crate::failure::Failure;

/// Interval between updates of the metrics file.
const METRICS_INTERVAL: Duration = Duration::from_secs(1);
/// Bytes of a trace written at a time.
const BLOCK_BYTES: usize = 64 << 10;
/// Trace blocks that may wait for the disk; further blocks are lost.
const BLOCKS_MAX: usize = 64;

/// The metrics file, whose content is always complete.
#[derive(Debug)]
pub struct MetricsFile {
    path: PathBuf,
    /// Dropped to end the thread.
    end: Sender<()>,
    thread: JoinHandle<()>,
}

impl MetricsFile {
    /// Starts writing the file once a second.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be written.
    pub fn begin(path: &Path, ask: SyncSender<Asked>) -> Result<Self, Failure> {
        write_whole(path, "")?;
        let (end, ended) = channel();
        let own = path.to_owned();
        let follow = move || {
            let mut is_told = false;
            while ended.recv_timeout(METRICS_INTERVAL) == Err(RecvTimeoutError::Timeout) {
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
        let thread = thread.map_err(Failure::unavailable)?;
        Ok(Self { path: path.to_owned(), end, thread })
    }

    /// Writes the last content.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be written.
    pub fn finish(self, text: &str) -> Result<(), Failure> {
        drop(self.end);
        let _ = self.thread.join();
        write_whole(&self.path, text)
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
    blocks: SyncSender<Vec<u8>>,
    lost_bytes: u64,
    thread: JoinHandle<std::io::Result<()>>,
}

impl TraceFile {
    /// Creates the file.
    ///
    /// # Errors
    /// [`Failure::Data`] if it can't be created.
    pub fn begin(path: &Path) -> Result<Self, Failure> {
        let mut file = File::create(path).map_err(|error| Failure::file(path, error))?;
        let (blocks, received) = sync_channel::<Vec<u8>>(BLOCKS_MAX);
        let follow = move || {
            // After an error the channel is closed and the remaining blocks are lost.
            received.into_iter().try_for_each(|block| file.write_all(&block))
        };
        let thread = std::thread::Builder::new().name("trace file".to_owned()).spawn(follow);
        let thread = thread.map_err(Failure::unavailable)?;
        Ok(Self { path: path.to_owned(), block: Vec::new(), blocks, lost_bytes: 0, thread })
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
        if let Err(TrySendError::Full(lost) | TrySendError::Disconnected(lost)) = self.blocks.try_send(block)
        {
            self.lost_bytes += lost.len() as u64;
        }
    }

    /// Writes the remaining packets.
    ///
    /// # Errors
    /// [`Failure::Data`] if the file could not be written, or the disk was slower than the trace.
    pub fn finish(mut self) -> Result<(), Failure> {
        let rest = std::mem::take(&mut self.block);
        // The run is over, so waiting is fine.
        let _ = self.blocks.send(rest);
        drop(self.blocks);
        let written = self.thread.join().unwrap_or_else(|_| Err(std::io::ErrorKind::Other.into()));
        written.map_err(|error| Failure::file(&self.path, error))?;
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
        file.finish("stgdat_linked 1\n").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "stgdat_linked 1\n");
        assert!(MetricsFile::begin(&folder.join("no/such.prom"), ask).is_err());
        std::fs::remove_dir_all(folder).unwrap();
    }
}
