//! Files that are written atomically.

use std::collections::hash_map::RandomState;
use std::fs::{self, File};
use std::hash::{BuildHasher as _, Hasher as _};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// A file that gets its name when it is finished.
///
/// Until then its content is stored beside the target in a new file, `NAME.RANDOM.partial`, or `NAME.partial`
/// if another process may resume it. A process that is killed leaves the partial file, and never a short file
/// under the real name. [Standard output](is_standard_output), pipes and devices are written directly. A link
/// is kept, and its target is replaced.
#[derive(Debug)]
pub struct WholeFile {
    output: BufWriter<File>,
    rename: Option<(PathBuf, PathBuf)>,
    /// Whether the partial file is removed if it is dropped unfinished.
    is_removed: bool,
}

impl WholeFile {
    /// Starts the file. If it is dropped unfinished, nothing of it is left.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::begin(path, &format!(".{:016x}.partial", RandomState::new().build_hasher().finish()))
    }

    /// Starts a file that [`WholeFile::resume`] continues if this process is killed.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn create_resumable(path: &Path) -> io::Result<Self> {
        Self::begin(path, RESUMABLE)
    }

    fn begin(path: &Path, suffix: &str) -> io::Result<Self> {
        if is_standard_output(path) {
            return Ok(Self::direct(io::stdout().as_fd().try_clone_to_owned()?.into()));
        }
        let path = match fs::metadata(path) {
            Ok(target) if target.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(target) if !target.is_file() => {
                return File::options().write(true).open(path).map(Self::direct);
            }
            _ => fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()),
        };
        let mut partial_name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?.to_owned();
        partial_name.push(suffix);
        let partial = path.with_file_name(partial_name);
        let is_removed = suffix != RESUMABLE;
        if !is_removed {
            // Of an earlier run, or a link to another file.
            match fs::remove_file(&partial) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        let output = BufWriter::with_capacity(1 << 18, File::create_new(&partial)?);
        Ok(Self { output, rename: Some((partial, path)), is_removed })
    }

    /// Continues the content of a process of this run that was killed or replaced, from its last whole line.
    /// Starts the file if there is no such content.
    ///
    /// # Errors
    /// The error of the file system.
    pub fn resume(path: &Path) -> io::Result<Self> {
        let mut name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?.to_owned();
        name.push(RESUMABLE);
        let resolved = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let partial = resolved.with_file_name(name);
        if is_standard_output(path) {
            return Self::create_resumable(path);
        }
        // A link is not followed.
        let is_file = fs::symlink_metadata(&partial).is_ok_and(|found| found.is_file());
        if !is_file && resolved.is_file() {
            // A process that was asked to end has finished its file.
            fs::rename(&resolved, &partial)?;
        } else if !is_file {
            return Self::create_resumable(path);
        }
        let mut output = File::options().read(true).write(true).open(&partial)?;
        let whole_len = whole_lines_len(&mut output)?;
        output.set_len(whole_len)?;
        output.seek(SeekFrom::Start(whole_len))?;
        let output = BufWriter::with_capacity(1 << 18, output);
        Ok(Self { output, rename: Some((partial, resolved)), is_removed: false })
    }

    fn direct(output: File) -> Self {
        Self { output: BufWriter::new(output), rename: None, is_removed: false }
    }

    /// Writes the data to the disk and gives the file its name. The file is whole after a power failure too.
    ///
    /// # Errors
    /// The error of the file system, such as a full disk.
    pub fn finish(mut self) -> io::Result<()> {
        self.output.flush()?;
        if self.rename.is_some() {
            self.output.get_ref().sync_all()?;
        }
        self.name()
    }

    /// Gives the file its name without waiting for the disk. The file is whole after the death of a process,
    /// but perhaps not after a power failure.
    fn finish_unsynced(mut self) -> io::Result<()> {
        self.output.flush()?;
        self.name()
    }

    fn name(mut self) -> io::Result<()> {
        let Some((partial, path)) = &self.rename else { return Ok(()) };
        fs::rename(partial, path)?;
        self.rename = None;
        Ok(())
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if let Some((partial, _)) = self.rename.as_ref().filter(|_| self.is_removed) {
            let _ = fs::remove_file(partial);
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

/// Ending of the name of a partial file that another process may resume.
const RESUMABLE: &str = ".partial";

/// Number of bytes up to the last line feed, which is searched from the end.
fn whole_lines_len(file: &mut File) -> io::Result<u64> {
    const BLOCK: u64 = 1 << 16;
    let mut end = file.seek(SeekFrom::End(0))?;
    let mut block = Vec::new();
    while end > 0 {
        let start = end.saturating_sub(BLOCK);
        file.seek(SeekFrom::Start(start))?;
        block.clear();
        Read::take(&*file, end - start).read_to_end(&mut block)?;
        if let Some(last) = block.iter().rposition(|&byte| byte == b'\n') {
            return Ok(start + last as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

/// Whether a path names standard output: `-` or `/dev/stdout`.
#[must_use]
pub fn is_standard_output(path: &Path) -> bool {
    path == Path::new("-") || path == Path::new("/dev/stdout")
}

/// Writes all of a small file.
pub(crate) fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(content)?;
    file.finish()
}

/// Writes all of a small file that is of no use after a power failure. It does not wait for the disk, so it
/// may be called between ticks.
pub(crate) fn write_state(path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    file.write_all(content)?;
    file.finish_unsynced()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_gets_its_name_when_it_is_finished() {
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
    fn a_link_in_the_place_of_the_partial_file_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let [path, other, partial] = ["a", "other", "a.partial"].map(|name| folder.path().join(name));
        let link = || std::os::unix::fs::symlink(&other, &partial).unwrap();
        fs::write(&other, b"of another user").unwrap();
        link();
        write(&path, b"one").unwrap();
        let mut file = WholeFile::create_resumable(&path).unwrap();
        file.write_all(b"two").unwrap();
        file.finish().unwrap();
        link();
        fs::remove_file(&path).unwrap();
        let mut file = WholeFile::resume(&path).unwrap();
        file.write_all(b"three").unwrap();
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"three");
        assert_eq!(fs::read(&other).unwrap(), b"of another user");
    }

    #[test]
    fn two_writers_of_a_file_do_not_mix_and_a_dropped_one_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        let [mut first, mut second] = [(); 2].map(|()| WholeFile::create(&path).unwrap());
        first.write_all(b"first").unwrap();
        second.write_all(b"2nd").unwrap();
        drop(WholeFile::create(&path).unwrap());
        second.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"2nd");
        first.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_killed_writer_is_followed_from_its_last_whole_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jsonl");
        let mut killed = WholeFile::create_resumable(&path).unwrap();
        killed.write_all(b"one\ntwo\nthr").unwrap();
        killed.flush().unwrap();
        drop(killed);
        let mut next = WholeFile::resume(&path).unwrap();
        next.write_all(b"four\n").unwrap();
        next.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"one\ntwo\nfour\n");
        assert!(WholeFile::resume(&folder.path().join("new")).is_ok());
    }

    #[test]
    fn a_folder_or_a_missing_folder_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write(&folder.path().join("no/such/a.json"), b"").is_err());
        assert!(WholeFile::create(folder.path()).is_err(), "before anything is computed");
    }

    #[test]
    fn a_link_is_kept_and_its_target_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [target, link] = ["a.json", "link"].map(|name| folder.path().join(name));
        fs::write(&target, b"old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(fs::read(&target).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }

    #[test]
    fn a_device_is_written_directly() {
        assert!(write(Path::new("/dev/null"), b"gone").is_ok());
        assert!(!Path::new("/dev/null.partial").exists());
    }
}
