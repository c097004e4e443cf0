//! The runs on this machine: live ones, and the files that dead ones have left.

use std::ffi::OsStr;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FlockOperation, OFlags};

use crate::half_made::is_older;
use crate::places::{
    SHARED_MEMORY, allocated, files_of, folders, is_lock, is_ours, lock_path, name_in, owner, root_of,
    seconds_of, take_lock,
};
use crate::removal::remove;

/// A run takes less time from its folder to its lock.
const YOUNG: Duration = Duration::from_secs(2);

/// Files of a run whose launcher has ended.
#[derive(Debug)]
pub struct Leftover {
    /// The run's name.
    pub name: String,
    /// Files in shared memory.
    pub file_count: usize,
    /// Total size of the files.
    pub bytes: u64,
    root: Option<PathBuf>,
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

/// A run of another user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ForeignRun {
    /// Name of the run.
    pub name: String,
    /// Number of the user.
    pub user: u32,
}

impl Leftover {
    /// Whether the run had its folder in `folder`.
    pub(crate) fn is_in(&self, folder: &Path) -> bool {
        self.root.as_ref().is_some_and(|root| root.parent() == Some(folder))
    }

    /// Removes all files of the run.
    pub fn remove(self) {
        remove(&self.name, self.root.as_deref());
    }
}

/// The runs of this user whose launcher has ended and whose files still exist.
///
/// # Errors
/// If the directories can't be read.
pub fn leftovers() -> io::Result<Vec<Leftover>> {
    Ok(names()?.into_iter().filter_map(leftover).collect())
}

/// The live runs of this user.
///
/// # Errors
/// If the directories can't be read.
pub fn living_runs() -> io::Result<Vec<LivingRun>> {
    let living = names()?.into_iter().filter(|name| is_locked(name));
    let living = living.filter_map(|name| Some(LivingRun { root: root_of(&name)?, name }));
    Ok(living.filter(|run| is_ours(&run.root)).collect())
}

/// The runs of other users, whether alive or not. Nobody else can open their files.
///
/// # Errors
/// If the directories can't be read.
pub fn foreign_runs() -> io::Result<Vec<ForeignRun>> {
    let mut runs = Vec::new();
    for entry in std::fs::read_dir(SHARED_MEMORY)? {
        let path = entry?.path();
        let name = path.file_name().and_then(OsStr::to_str).and_then(name_in);
        if let (Some(name), Some(user)) = (name, owner(&path))
            && is_lock(&path)
            && !is_ours(&path)
        {
            runs.push(ForeignRun { name, user });
        }
    }
    Ok(runs)
}

/// The number of files of a run in shared memory, and of its folders in the usual places.
#[must_use]
pub fn files_left(name: &str) -> usize {
    let roots = folders().into_iter().map(|folder| folder.join(name));
    let folders = roots.map(|root| usize::from(is_ours(&root)) + seconds_of(&root).len());
    files_of(name).len() + folders.sum::<usize>()
}

/// The names of all runs that have files.
fn names() -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    for folder in folders().into_iter().chain([SHARED_MEMORY.into()]) {
        let about = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", folder.display()));
        for entry in std::fs::read_dir(&folder).map_err(about)? {
            names.extend(entry.map_err(about)?.file_name().to_str().and_then(name_in));
        }
    }
    names.sort();
    names.dedup();
    Ok(names)
}

/// Whether a run of this user is alive: its launcher holds its lock.
fn is_locked(name: &str) -> bool {
    let Some(path) = lock_path(name) else { return false };
    // Shared: two processes that check at once do not take each other for a launcher.
    let taken = take_lock(&path, OFlags::empty(), FlockOperation::NonBlockingLockShared);
    taken.is_err_and(|error| error.kind() == io::ErrorKind::WouldBlock)
}

/// The leftover of a run, if the run is dead and belongs to this user.
fn leftover(name: String) -> Option<Leftover> {
    let lock = match lock_path(&name) {
        Some(path) => match take_lock(&path, OFlags::empty(), FlockOperation::NonBlockingLockExclusive) {
            Ok(lock) => Some(lock),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            // Locked: the run is alive.
            Err(_) => return None,
        },
        None => None,
    };
    let (files, root) = (files_of(&name), root_of(&name).or_else(|| second_root(&name)));
    if files.is_empty() && root.is_none() {
        return None;
    }
    // A run that starts creates its folder before its lock.
    let is_young = |root: &PathBuf| std::fs::metadata(root).is_ok_and(|found| !is_older(&found, YOUNG));
    if lock.is_none() && root.as_ref().is_some_and(is_young) {
        return None;
    }
    let bytes = files.iter().map(|file| allocated(file)).sum();
    Some(Leftover { file_count: files.len(), bytes, root, _lock: lock, name })
}

/// The folder that a run had, if only the folder with second names is left.
fn second_root(name: &str) -> Option<PathBuf> {
    let roots = folders().into_iter().map(|folder| folder.join(OsStr::new(name)));
    roots.into_iter().find(|root: &PathBuf| !seconds_of(Path::new(root)).is_empty())
}
