//! Files that appear whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A file that takes its name only when it is finished.
///
/// Until then its content lies beside the target as `NAME.partial`; so a run that is cut off leaves the partial file
/// and never a short one under the real name. A target that exists and is no regular file (a pipe, `/dev/stdout`) is
/// written directly.
#[derive(Debug)]
pub struct WholeFile {
    output: BufWriter<File>,
    rename: Option<(PathBuf, PathBuf)>,
}

impl WholeFile {
    /// Starts the file.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(path: &Path) -> io::Result<Self> {
        if fs::metadata(path).is_ok_and(|target| !target.is_file() && !target.is_dir()) {
            return Ok(Self {
                output: BufWriter::new(File::options().write(true).open(path)?),
                rename: None,
            });
        }
        let name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?;
        let mut partial_name = name.to_owned();
        partial_name.push(".partial");
        let partial = path.with_file_name(partial_name);
        let output = BufWriter::with_capacity(1 << 18, File::create(&partial)?);
        Ok(Self { output, rename: Some((partial, path.to_owned())) })
    }

    /// Writes what is buffered and gives the file its name.
    ///
    /// # Errors
    /// What the file system says, such as a full disk.
    pub fn finish(mut self) -> io::Result<()> {
        self.output.flush()?;
        match &self.rename {
            Some((partial, path)) => fs::rename(partial, path),
            None => Ok(()),
        }
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.output.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

/// Writes all of a small file.
pub(crate) fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(content)?;
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_appears_with_the_last_byte() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"one\n").unwrap();
        assert!(!path.exists());
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"one\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no partial file is left");
    }

    #[test]
    fn a_missing_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(&folder.path().join("no/such/a.json"), b"").is_err());
        assert!(write(folder.path(), b"").is_err());
    }

    #[test]
    fn a_device_is_written_directly() {
        assert!(write(Path::new("/dev/null"), b"gone").is_ok());
        assert!(!Path::new("/dev/null.partial").exists());
    }
}
