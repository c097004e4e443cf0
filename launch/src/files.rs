//! Files and words that a command line names.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::os::fd::IntoRawFd as _;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use rustix::fs::{Access, MemfdFlags, memfd_create};

use configuration::options::absolute;
use console::failure::Failure;

/// Folders of shipped weights, relative to the folder of the program: installed, and in the source tree.
const SHIPPED: [&str; 2] = ["../share/stgdat/weights", "../../shared/weights"];

/// The file of weights that a command line names: a path, or the name of shipped weights.
pub fn named_weights(name: &Path) -> PathBuf {
    shipped_weights(name).unwrap_or_else(|| name.to_owned())
}

/// The file of shipped weights with this name; `None` if the text is a path, or no shipped weights have this name.
pub fn shipped_weights(name: &Path) -> Option<PathBuf> {
    let is_name = name.components().count() == 1 && name.extension().is_none() && !name.exists();
    let program = std::env::current_exe().ok().filter(|_| is_name)?;
    let file = name.with_extension("safetensors");
    let places = SHIPPED.iter().map(|folder| Some(program.parent()?.join(folder).join(&file)));
    places.flatten().find_map(|place| place.canonicalize().ok())
}

/// Copies a pipe or standard input (`-`) into memory, because the processes of a run read a recording by its path,
/// more than once. Returns the path of the copy, which is valid while this process lives; `None` for a file.
///
/// # Errors
/// [`Failure::Data`] if the pipe can't be read or its content is too large.
pub fn spooled(path: &Path) -> Result<Option<PathBuf>, Failure> {
    // A pipe can be read once, but a verb may ask for its recording more than once.
    static COPIES: Mutex<BTreeMap<PathBuf, PathBuf>> = Mutex::new(BTreeMap::new());
    let mut copies = COPIES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(copy) = copies.get(path) {
        return Ok(Some(copy.clone()));
    }
    let is_input = data::is_standard_input(path);
    let opened = if is_input { Path::new(data::STANDARD_INPUT) } else { path };
    let failed = |error| Failure::file(path, error);
    if !is_input && !std::fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo()) {
        return Ok(None);
    }
    let memory = memfd_create("recording", MemfdFlags::CLOEXEC).map_err(|error| failed(error.into()))?;
    let mut memory = File::from(memory);
    let mut input = File::open(opened).map_err(failed)?.take(data::FILE_BYTES_MAX + 1);
    if std::io::copy(&mut input, &mut memory).map_err(failed)? > data::FILE_BYTES_MAX {
        return Err(failed(std::io::ErrorKind::FileTooLarge.into()));
    }
    // The copy stays open until this process ends.
    let copy = PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), memory.into_raw_fd()));
    copies.insert(path.to_owned(), copy.clone());
    Ok(Some(copy))
}

/// Checks that an output file can be written, as [`check_place`], and that it does not exist unless `force`
/// permits to replace it.
///
/// # Errors
/// [`Failure::Data`] as for [`check_place`], or if the file exists.
pub fn check_new(path: &Path, force: bool) -> Result<(), Failure> {
    if !force && !recorder::is_standard_output(path) && path.is_file() {
        return Err(Failure::file(path, "the file exists: name another one, or replace it with --force"));
    }
    check_place(path)
}

/// Time for a disk to take a file at the end of a run.
const WRITE_LIMIT: Duration = Duration::from_secs(10);

/// Writes a file in a thread of its own, because a disk may not answer.
///
/// # Errors
/// The error of `write`, or [`Failure::Data`] after ten seconds.
pub fn within(
    path: &Path,
    write: impl FnOnce() -> Result<(), Failure> + Send + 'static,
) -> Result<(), Failure> {
    let (done, is_done) = sync_channel(1);
    std::thread::spawn(move || done.send(write()));
    let slow = |_| Err(Failure::file(path, std::io::Error::from(std::io::ErrorKind::TimedOut)));
    is_done.recv_timeout(WRITE_LIMIT).unwrap_or_else(slow)
}

/// Checks that an output file can be written, before the work that produces it starts.
///
/// # Errors
/// [`Failure::Data`] if `path` is a folder or this user can't write to its parent folder.
pub fn check_place(path: &Path) -> Result<(), Failure> {
    if recorder::is_standard_output(path) {
        return Ok(());
    }
    let path = std::fs::canonicalize(path).or_else(|_| absolute(path))?;
    if path.is_dir() {
        return Err(Failure::file(&path, std::io::Error::from(std::io::ErrorKind::IsADirectory)));
    }
    let (written, how) = match path.parent() {
        // A complete file replaces the old one.
        Some(folder) if path.is_file() || !path.exists() => (folder, Access::WRITE_OK | Access::EXEC_OK),
        _ => (&*path, Access::WRITE_OK),
    };
    let access = rustix::fs::access(written, how);
    access.map_err(|error| Failure::file(written, std::io::Error::from(error)))
}

/// A mark of a file's content that differs after each replacement or write; `None` if there is no such file.
/// Marks are not ordered in time, so a step of the clock does no harm.
pub fn version(path: &Path) -> Option<(u64, i64, i64)> {
    let file = std::fs::metadata(path).ok()?;
    Some((file.ino(), file.mtime(), file.mtime_nsec()))
}

/// Quotes a word of a command line if a shell needs it.
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    match word.chars().all(is_plain) && !word.is_empty() {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;

    #[test]
    fn a_file_written_after_the_clock_went_back_is_another_version() {
        let path = std::env::temp_dir().join(format!("stgdat-version-{}", std::process::id()));
        assert_eq!(version(&path), None);
        std::fs::write(&path, "old").unwrap();
        let old = version(&path);
        assert!(old.is_some() && version(&path) == old);
        std::fs::write(&path, "new").unwrap();
        let an_hour_ago = SystemTime::now() - Duration::from_secs(3600);
        std::fs::File::options().write(true).open(&path).unwrap().set_modified(an_hour_ago).unwrap();
        assert!(version(&path).is_some() && version(&path) != old);
        std::fs::remove_file(&path).unwrap();
    }
}
