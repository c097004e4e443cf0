use std::fs::File;
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// The destination of a recording: whole blocks in sequence.
pub trait Sink {
    /// Appends a block as a whole or not at all.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk; later blocks may succeed.
    fn append(&mut self, block: &[u8]) -> io::Result<()>;

    /// Waits until all appended blocks are on the disk.
    ///
    /// # Errors
    /// The error of the file system.
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Interval at which a file is written to the disk: a power failure loses about this much.
const SYNC_INTERVAL: Duration = Duration::from_secs(1);

/// A file. A thread writes it to the disk every second, so that no block waits for the disk.
#[derive(Debug)]
pub struct FileSink {
    file: File,
    /// Number of appended bytes.
    len: u64,
    /// Asks the thread to write to the disk. At most one request waits.
    requests: SyncSender<()>,
    /// When the last request was made.
    requested_at: Instant,
}

impl FileSink {
    /// Creates the file.
    ///
    /// # Errors
    /// If a file with this name exists, which may be worth more than this recording, or if it can't be
    /// created.
    pub fn create(path: &Path) -> io::Result<Self> {
        match File::options().read(true).write(true).create_new(true).open(path) {
            Ok(file) => Self::new(file),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(io::Error::new(error.kind(), "there is a file of that name, which is not replaced"))
            }
            Err(error) => Err(error),
        }
    }

    fn new(file: File) -> io::Result<Self> {
        let (requests, received) = sync_channel(1);
        let of_thread = file.try_clone()?;
        // The thread ends with the sink. The end of the file waits for the disk and returns its errors.
        let follow = move || received.into_iter().for_each(|()| drop(of_thread.sync_data()));
        std::thread::Builder::new().name("sync".to_owned()).spawn(follow)?;
        Ok(Self { file, len: 0, requests, requested_at: Instant::now() })
    }
}

impl Sink for FileSink {
    fn append(&mut self, block: &[u8]) -> io::Result<()> {
        if let Err(error) = self.file.write_all(block) {
            // A part of the block may have been written. Without that part the file ends with a whole record
            // again.
            self.file.set_len(self.len)?;
            self.file.seek(SeekFrom::Start(self.len))?;
            return Err(error);
        }
        self.len += block.len() as u64;
        if self.requested_at.elapsed() >= SYNC_INTERVAL {
            self.requested_at = Instant::now();
            // If the channel is full, the request that waits is enough.
            let _ = self.requests.try_send(());
        }
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        self.file.sync_all()
    }
}

impl Sink for Vec<u8> {
    fn append(&mut self, block: &[u8]) -> io::Result<()> {
        self.extend_from_slice(block);
        Ok(())
    }
}
