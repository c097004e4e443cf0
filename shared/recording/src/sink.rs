use std::fs::File;
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::path::Path;

/// The destination of a recording: whole blocks in sequence.
pub trait Sink {
    /// Appends a block as a whole or not at all.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk; later blocks may succeed.
    fn append(&mut self, block: &[u8]) -> io::Result<()>;
}

/// A file.
#[derive(Debug)]
pub struct FileSink {
    file: File,
    /// Number of appended bytes.
    len: u64,
}

impl FileSink {
    /// Creates the file.
    ///
    /// # Errors
    /// If a file with this name exists, which may be worth more than this recording, or if it can't be
    /// created.
    pub fn create(path: &Path) -> io::Result<Self> {
        match File::options().read(true).write(true).create_new(true).open(path) {
            Ok(file) => Ok(Self { file, len: 0 }),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                Err(io::Error::new(error.kind(), "there is a file of that name, which is not replaced"))
            }
            Err(error) => Err(error),
        }
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
        Ok(())
    }
}

impl Sink for Vec<u8> {
    fn append(&mut self, block: &[u8]) -> io::Result<()> {
        self.extend_from_slice(block);
        Ok(())
    }
}
