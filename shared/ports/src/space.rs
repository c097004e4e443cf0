//! The files of a run: names in shared memory, a directory for sockets and records, and a lock that shows
//! whether the run is alive.
//!
//! Every name in shared memory starts with the run's prefix. The lock is also in shared memory. A process
//! that sees a run's shared memory can therefore see whether its launcher is alive. A process number does not
//! show this across containers.

use std::fs::{File, Metadata};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FlockOperation, Mode, OFlags, StatVfs, flock, fstat, open, statvfs};
use thiserror::Error;

use crate::keep::Keep;

/// The directory that shows POSIX shared memory as files.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// The directory of the runs' directories. Not `TMPDIR`: a socket's path must stay under 108 bytes, and
/// `stgdat clean` must find the directories of runs that were started with another `TMPDIR`.
const ROOTS: &str = "/tmp";
/// Prefix of all names of all runs.
const FAMILY: &str = "stgdat_";
/// Digits of a run's name after [`FAMILY`].
const DIGITS: usize = 8;
const LOCK_SUFFIX: &str = "lock";
/// The file in a run's directory that holds the run's record.
const RECORD: &str = "run";
/// The folder in a run's directory that holds the descriptions of its services.
const SERVICES: &str = "services";

/// Why a run's files can't be created.
#[derive(Debug, Error)]
pub enum SpaceError {
    /// A file or directory can't be created.
    #[error("{}: {source}", path.display())]
    File {
        /// The file or directory.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Shared memory has too little space.
    #[error(
        "{SHARED_MEMORY} has {free_mib} MiB free, a run needs {needed_mib} MiB: free some (`stgdat clean` removes \
         leftovers) or give it more (`mount -o remount,size=1G {SHARED_MEMORY}`, `docker run --shm-size=1g`)"
    )]
    Full {
        /// Free space.
        free_mib: u64,
        /// Required space.
        needed_mib: u64,
    },
}

/// The files of one run; dropping it removes all of them.
#[derive(Debug)]
pub struct Space {
    prefix: String,
    root: PathBuf,
    keep: Option<Keep>,
    /// Locked until the launcher ends, killed or not.
    lock: File,
}

/// Files of a run whose launcher has ended.
#[derive(Debug)]
pub struct Leftover {
    /// The run's prefix.
    pub prefix: String,
    /// Files in shared memory.
    pub file_count: usize,
    /// Total size of the files.
    pub bytes: u64,
    root: PathBuf,
    /// Held so that no two processes clean up the same run. `None` if the lock's file was missing.
    _lock: Option<File>,
}

/// A run whose launcher is alive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LivingRun {
    /// Name of the run and of its directory.
    pub name: String,
    /// Directory of the run, which contains the run's record.
    pub root: PathBuf,
}

impl Space {
    /// Creates the files of a run with the number `run_id`.
    ///
    /// # Errors
    /// [`SpaceError`] if shared memory has less than `needed_bytes` free, or the files can't be created.
    pub fn create(run_id: u64, needed_bytes: u64) -> Result<Self, SpaceError> {
        let free =
            shared_memory_free().map_err(|source| SpaceError::File { path: SHARED_MEMORY.into(), source })?;
        if free < needed_bytes {
            return Err(SpaceError::Full {
                free_mib: free >> 20,
                needed_mib: needed_bytes.div_ceil(1 << 20),
            });
        }
        let prefix = format!("{FAMILY}{:0DIGITS$x}_", run_id as u32);
        let lock_path = lock_path(&prefix);
        let lock = make_lock(&lock_path).map_err(|source| SpaceError::File { path: lock_path, source })?;
        let root = root_of(&prefix);
        let mut space = Self { prefix, root, keep: None, lock };
        std::fs::create_dir(&space.root)
            .map_err(|source| SpaceError::File { path: space.root.clone(), source })?;
        let second = second_of(&space.prefix);
        let keep = Keep::begin(&space.root, &second, RECORD);
        space.keep = Some(keep.map_err(|source| SpaceError::File { path: second, source })?);
        Ok(space)
    }

    /// Restores files of the run's directory that another program has removed because they looked old. It
    /// works once the run's record exists, and takes one system call if nothing is missing. Returns the
    /// number of restored files.
    pub fn tend(&mut self) -> usize {
        self.keep.as_mut().map_or(0, Keep::tend)
    }

    /// Protects the current files of the run's directory.
    pub fn keep(&mut self) {
        if let Some(keep) = &mut self.keep {
            keep.take_in();
        }
    }

    /// Prefix of the names of the run's shared memory.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The run's directory.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Bytes of shared memory that the run uses now.
    #[must_use]
    pub fn shared_bytes(&self) -> u64 {
        files_of(&self.prefix).iter().map(|file| allocated(file)).sum()
    }
}

impl Drop for Space {
    fn drop(&mut self) {
        remove(&self.prefix, &self.root);
        // The lock is released last, when its file's name has already been removed.
        let _ = &self.lock;
    }
}

impl Leftover {
    /// Removes all files of the run.
    pub fn remove(self) {
        remove(&self.prefix, &self.root);
    }
}

/// Removes the connections of a run that have been empty for longer than `age`; returns their number. A
/// process that is killed while it creates a connection leaves an empty one, and clean-up would wait forever
/// for it to be finished.
#[must_use]
pub fn remove_half_made_connections(prefix: &str, age: Duration) -> usize {
    let is_half_made = |file: &&PathBuf| {
        file.extension().is_some_and(|extension| extension == "connection")
            && std::fs::metadata(file).is_ok_and(|metadata| metadata.len() == 0 && is_older(&metadata, age))
    };
    let files = files_of(prefix);
    files.iter().filter(is_half_made).filter(|file| std::fs::remove_file(file).is_ok()).count()
}

/// Removes the services of a run that have been half created for longer than `age`; returns their number. A
/// process that is killed while it creates a service leaves one. Others wait for it to be finished, and
/// clean-up refuses it.
pub(crate) fn remove_half_made_services(root: &Path, age: Duration) -> usize {
    half_made_services(root, age).iter().filter(|path| std::fs::remove_file(path).is_ok()).count()
}

/// The services of a run that have been half created for longer than `age`.
pub(crate) fn half_made_services(root: &Path, age: Duration) -> Vec<PathBuf> {
    use std::os::unix::fs::PermissionsExt;
    /// Until a service's description is complete, its owner may write it.
    const HALF_MADE: u32 = 0o200;
    let is_half_made = |path: &Path| {
        let Ok(metadata) = std::fs::metadata(path) else { return false };
        metadata.is_file() && metadata.permissions().mode() & HALF_MADE != 0 && is_older(&metadata, age)
    };
    let Ok(entries) = std::fs::read_dir(root.join(SERVICES)) else { return Vec::new() };
    entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| is_half_made(path)).collect()
}

/// Whether a file has been unchanged for longer than `age`.
pub(crate) fn is_older(metadata: &Metadata, age: Duration) -> bool {
    metadata.modified().is_ok_and(|at| at.elapsed().is_ok_and(|elapsed| elapsed > age))
}

/// Free bytes in shared memory.
///
/// # Errors
/// If there is no shared memory.
pub fn shared_memory_free() -> io::Result<u64> {
    let StatVfs { f_bavail, f_frsize, .. } = statvfs(SHARED_MEMORY)?;
    Ok(f_bavail * f_frsize)
}

/// The runs of this user whose launcher has ended and whose files still exist.
///
/// # Errors
/// If the directories can't be read.
pub fn leftovers() -> io::Result<Vec<Leftover>> {
    Ok(prefixes()?.into_iter().filter_map(leftover).collect())
}

/// The live runs of this user.
///
/// # Errors
/// If the directories can't be read.
pub fn living_runs() -> io::Result<Vec<LivingRun>> {
    let living = prefixes()?
        .into_iter()
        .filter(|prefix| is_locked(prefix))
        .map(|prefix| LivingRun { root: root_of(&prefix), name: prefix.trim_end_matches('_').to_owned() });
    Ok(living.filter(|run| is_ours(&run.root)).collect())
}

/// The prefixes of all runs that have files.
fn prefixes() -> io::Result<Vec<String>> {
    let mut prefixes = Vec::new();
    for directory in [SHARED_MEMORY, ROOTS] {
        for entry in std::fs::read_dir(directory)? {
            let name = entry?.file_name();
            prefixes.extend(name.to_str().and_then(prefix_of));
        }
    }
    prefixes.sort();
    prefixes.dedup();
    Ok(prefixes)
}

/// Whether a run's launcher holds its lock.
fn is_locked(prefix: &str) -> bool {
    let path = lock_path(prefix);
    // Shared: two processes that check at once do not take each other for a launcher.
    let taken = take_lock(&path, OFlags::empty(), FlockOperation::NonBlockingLockShared);
    is_ours(&path) && taken.is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock)
}

/// The leftover of a run, if the run is dead and belongs to this user.
fn leftover(prefix: String) -> Option<Leftover> {
    let lock = match take_lock(&lock_path(&prefix), OFlags::empty(), FlockOperation::NonBlockingLockExclusive)
    {
        Ok(lock) => Some(lock),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        // Locked: the run is alive. Not permitted: another user's run.
        Err(_) => return None,
    };
    let (files, root) = (files_of(&prefix), root_of(&prefix));
    if files.is_empty() && !is_ours(&root) && !is_ours(&second_of(&prefix)) {
        return None;
    }
    let bytes = files.iter().map(|file| allocated(file)).sum();
    Some(Leftover { file_count: files.len(), bytes, root, _lock: lock, prefix })
}

/// Creates the lock of a new run and takes it. A process that looks for leftovers at that moment may hold the
/// lock briefly, and may have removed its file.
fn make_lock(path: &Path) -> io::Result<File> {
    let make = || take_lock(path, OFlags::CREATE | OFlags::EXCL, FlockOperation::LockExclusive);
    match make() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => make(),
        made => made,
    }
}

fn take_lock(path: &Path, how: OFlags, lock: FlockOperation) -> io::Result<File> {
    let descriptor =
        open(path, OFlags::RDWR | OFlags::CLOEXEC | OFlags::NOFOLLOW | how, Mode::RUSR | Mode::WUSR)?;
    flock(&descriptor, lock)?;
    if fstat(&descriptor)?.st_nlink == 0 {
        // The file was removed between opening and locking.
        return Err(io::ErrorKind::NotFound.into());
    }
    Ok(descriptor.into())
}

fn lock_path(prefix: &str) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{prefix}{LOCK_SUFFIX}"))
}

fn root_of(prefix: &str) -> PathBuf {
    Path::new(ROOTS).join(prefix.trim_end_matches('_'))
}

/// The hidden directory with the second names of the files in a run's directory.
fn second_of(prefix: &str) -> PathBuf {
    Path::new(ROOTS).join(format!(".{}", prefix.trim_end_matches('_')))
}

/// The prefix of the run that a file or directory belongs to, by its name.
fn prefix_of(name: &str) -> Option<String> {
    let digits = name.strip_prefix('.').unwrap_or(name).strip_prefix(FAMILY)?.get(..DIGITS)?;
    digits.bytes().all(|b| b.is_ascii_hexdigit()).then(|| format!("{FAMILY}{digits}_"))
}

fn files_of(prefix: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(SHARED_MEMORY) else { return Vec::new() };
    let ours = entries
        .filter_map(Result::ok)
        .filter(|e| e.file_name().to_str().is_some_and(|n| n.starts_with(prefix)));
    let mut files: Vec<PathBuf> = ours.map(|entry| entry.path()).filter(|path| is_ours(path)).collect();
    files.sort();
    files
}

fn is_ours(path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::symlink_metadata(path).is_ok_and(|m| m.uid() == rustix::process::geteuid().as_raw())
}

fn allocated(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt;
    std::fs::symlink_metadata(path).map_or(0, |m| m.blocks() * 512)
}

/// Removes a run's files, the lock last: while the lock is held, no other process takes the files for
/// leftovers.
fn remove(prefix: &str, root: &Path) {
    let lock = lock_path(prefix);
    for file in files_of(prefix).into_iter().filter(|file| *file != lock) {
        let _ = std::fs::remove_file(file);
    }
    for directory in [root, &second_of(prefix)] {
        if is_ours(directory) {
            let _ = std::fs::remove_dir_all(directory);
        }
    }
    let _ = std::fs::remove_file(lock);
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn half_made_services_alone_are_removed_once_they_are_old() {
        let root = std::env::temp_dir().join(format!("stgdat_half_made_{}", std::process::id()));
        let services = root.join(SERVICES);
        std::fs::create_dir_all(&services).unwrap();
        for (name, mode) in [("whole.service", 0o400), ("half.service", 0o600)] {
            std::fs::write(services.join(name), "x").unwrap();
            std::fs::set_permissions(services.join(name), Permissions::from_mode(mode)).unwrap();
        }
        let young = remove_half_made_services(&root, Duration::from_secs(3_600));
        std::thread::sleep(Duration::from_millis(2));
        let old = remove_half_made_services(&root, Duration::ZERO);
        let is_left = ["whole.service", "half.service"].map(|name| services.join(name).exists());
        std::fs::remove_dir_all(&root).unwrap();
        assert_eq!((young, old, is_left), (0, 1, [true, false]));
        assert_eq!(remove_half_made_services(&root, Duration::ZERO), 0, "a run that is gone has none");
    }
}
