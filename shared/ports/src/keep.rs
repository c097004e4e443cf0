//! Keeps the folder of a run. Programs may remove files from it that look old: systemd-tmpfiles does so in
//! `/tmp` after ten days.
//!
//! 1. A shared BSD lock on the folder. systemd-tmpfiles respects this lock.
//! 2. A second name for each file: a hard link in a hidden folder. If the run's record has disappeared,
//!    somebody has removed files, and every file gets its name back. The files themselves are unchanged, so
//!    their locks hold and their sockets still work.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs::DirEntry;
use std::os::fd::OwnedFd;
use std::os::unix::fs::DirEntryExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};

use crate::places::{create_private, is_ours};

/// Interval between scans for new files.
const LOOK: Duration = Duration::from_secs(1);
/// Time in which a program may still remove files after the sentinel. During this time all files are restored
/// repeatedly.
const REMOVAL: Duration = Duration::from_millis(250);
/// Nested folders: the run's, the nodes' folder, and a node's.
const DEPTH_MAX: usize = 3;

/// Protects a folder from removal.
#[derive(Debug)]
pub(crate) struct Keep {
    folder: PathBuf,
    /// The folder with the second names.
    second: PathBuf,
    /// A file that exists as long as the run does. If it is missing, files were removed.
    sentinel: PathBuf,
    /// Locks on both folders.
    locks: [Option<OwnedFd>; 2],
    looked: Instant,
    /// When the sentinel was last found removed.
    restoring: Option<Instant>,
    /// Second names whose files were missing at the last scan. If they are missing again, the removal was
    /// intended.
    gone: BTreeSet<PathBuf>,
}

impl Keep {
    /// Protects a folder, with the second names in the empty folder `second`. The protection depends on the
    /// file `sentinel`.
    pub fn begin(folder: &Path, second: &Path, sentinel: &str) -> Self {
        let locks = [lock(folder), lock(second)];
        let (looked, gone) = (Instant::now(), BTreeSet::new());
        let (folder, second, sentinel) = (folder.to_owned(), second.to_owned(), folder.join(sentinel));
        Self { folder, second, sentinel, locks, looked, restoring: None, gone }
    }

    /// Restores removed files, and links new files once a second. Returns the number of restored files at the
    /// first scan that finds the sentinel removed.
    pub fn tend(&mut self) -> usize {
        if !self.sentinel.exists() && self.second_sentinel().exists() {
            let is_first = self.restoring.replace(Instant::now()).is_none();
            let restored = self.restore();
            return if is_first { restored } else { 0 };
        }
        match self.restoring {
            // Files that a process itself removes meanwhile come back too. The clean-up handles them like
            // those of a dead process.
            Some(since) if since.elapsed() < REMOVAL => {
                self.restore();
                return 0;
            }
            Some(_) => self.restoring = None,
            None => {}
        }
        if self.looked.elapsed() >= LOOK {
            self.looked = Instant::now();
            self.take_in();
        }
        0
    }

    /// Whether files were removed a moment ago and are being restored.
    pub const fn is_restoring(&self) -> bool {
        self.restoring.is_some()
    }

    /// Links all current files.
    pub fn take_in(&mut self) {
        let mut gone = BTreeSet::new();
        mirror(&self.folder, &self.second, DEPTH_MAX, &mut gone);
        // Another program may be removing everything at this moment. A file that is missing twice while the
        // record exists was removed on purpose.
        if self.sentinel.exists() {
            for path in gone.intersection(&self.gone) {
                let _ = std::fs::remove_file(path).or_else(|_| std::fs::remove_dir_all(path));
            }
            self.gone = gone;
        }
    }

    fn restore(&mut self) -> usize {
        let had_folder = self.folder.exists();
        let restored = restore(&self.second, &self.folder);
        if !had_folder {
            self.locks[0] = lock(&self.folder);
        }
        self.gone.clear();
        restored
    }

    fn second_sentinel(&self) -> PathBuf {
        self.second.join(self.sentinel.file_name().unwrap_or_default())
    }
}

/// Gives each file of `from` a second name in `to`; adds files that only `to` has to `gone`.
fn mirror(from: &Path, to: &Path, depth: usize, gone: &mut BTreeSet<PathBuf>) {
    let (here, there) = (list(from), list(to));
    for (name, entry) in &here {
        let (source, second) = (from.join(name), to.join(name));
        if entry.is_folder {
            if depth > 1 && (there.contains_key(name) || make_like(&source, &second)) {
                mirror(&source, &second, depth - 1, gone);
            }
        } else if there.get(name).is_none_or(|second| second.inode != entry.inode) {
            // Another file has that name, or a file that is being removed.
            let _ = std::fs::remove_file(&second);
            let _ = std::fs::hard_link(&source, &second);
        }
    }
    gone.extend(there.into_keys().filter(|name| !here.contains_key(name)).map(|name| to.join(name)));
}

/// Gives the files of `second` their names in `folder` back; returns the number of files restored.
fn restore(second: &Path, folder: &Path) -> usize {
    if !folder.exists() {
        make_like(second, folder);
    }
    // Another user may have taken the name meanwhile.
    if !is_ours(folder) {
        return 0;
    }
    let restored = list(second).into_iter().map(|(name, entry)| {
        let (source, path) = (second.join(&name), folder.join(&name));
        if entry.is_folder {
            return restore(&source, &path);
        }
        // Fails if the file has its name.
        usize::from(std::fs::hard_link(source, path).is_ok())
    });
    restored.sum()
}

/// A file of a folder.
#[derive(Clone, Copy, Debug)]
struct Entry {
    inode: u64,
    is_folder: bool,
}

/// The files of a folder; none if it can't be read.
fn list(folder: &Path) -> BTreeMap<OsString, Entry> {
    let entry = |entry: DirEntry| {
        let is_folder = entry.file_type().ok()?.is_dir();
        Some((entry.file_name(), Entry { inode: entry.ino(), is_folder }))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    entries.filter_map(entry).collect()
}

/// Creates a folder with the permissions of another one. Returns whether the folder exists.
fn make_like(other: &Path, folder: &Path) -> bool {
    let made = std::fs::metadata(other).and_then(|found| {
        create_private(folder)?;
        std::fs::set_permissions(folder, found.permissions())
    });
    made.is_ok()
}

/// Takes the shared lock on a folder. Without the lock only the second names protect the files.
fn lock(folder: &Path) -> Option<OwnedFd> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC | OFlags::NOFOLLOW;
    let descriptor = open(folder, flags, Mode::empty()).ok()?;
    flock(&descriptor, FlockOperation::NonBlockingLockShared).ok()?;
    Some(descriptor)
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::{UnixListener, UnixStream};

    use super::*;

    /// A folder with a record, a socket and nested files, which is kept.
    fn kept(name: &str) -> (PathBuf, Keep, UnixListener) {
        let base = std::env::temp_dir().join(format!("stgdat_keep_{name}_{}", std::process::id()));
        let folder = base.join("run");
        std::fs::create_dir_all(folder.join("nodes/7")).unwrap();
        for file in ["run", "nodes/a.node_monitor", "nodes/7/tag"] {
            std::fs::write(folder.join(file), file).unwrap();
        }
        let socket = UnixListener::bind(folder.join("status")).unwrap();
        std::fs::create_dir(base.join(".run")).unwrap();
        let mut keep = Keep::begin(&folder, &base.join(".run"), "run");
        keep.take_in();
        (base, keep, socket)
    }

    #[test]
    fn files_that_are_removed_come_back_as_the_same_files() {
        let (base, mut keep, _socket) = kept("back");
        let folder = base.join("run");
        let inode = |file: &str| {
            use std::os::unix::fs::MetadataExt as _;
            std::fs::metadata(folder.join(file)).unwrap().ino()
        };
        let before = ["run", "nodes/a.node_monitor", "nodes/7/tag"].map(inode);
        assert_eq!(keep.tend(), 0, "nothing is missing");
        std::fs::remove_file(folder.join("run")).unwrap();
        std::fs::remove_file(folder.join("nodes/a.node_monitor")).unwrap();
        assert_eq!(keep.tend(), 2);
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(keep.tend(), 0, "counted once");
        assert_eq!(["run", "nodes/a.node_monitor", "nodes/7/tag"].map(inode), before);
        assert!(UnixStream::connect(folder.join("status")).is_ok());
        std::fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn what_its_owner_removes_stays_removed() {
        let (base, mut keep, _socket) = kept("removed");
        let (tag, second) = (base.join("run/nodes/7/tag"), base.join(".run/nodes/7/tag"));
        std::fs::remove_file(&tag).unwrap();
        keep.take_in();
        assert!(second.exists(), "somebody may be removing everything");
        keep.take_in();
        assert!(!second.exists());
        std::fs::write(base.join("run/new"), "x").unwrap();
        keep.take_in();
        std::fs::remove_file(base.join("run/run")).unwrap();
        std::fs::remove_file(base.join("run/new")).unwrap();
        assert_eq!(keep.tend(), 2);
        assert!(!tag.exists() && base.join("run/new").exists());
        std::fs::remove_dir_all(base).unwrap();
    }

    #[test]
    fn both_folders_are_locked_against_programs_that_remove_old_files() {
        let (base, mut keep, _socket) = kept("locked");
        let is_locked = |name: &str| {
            let folder = std::fs::File::open(base.join(name)).unwrap();
            flock(&folder, FlockOperation::NonBlockingLockExclusive).is_err()
        };
        assert!(is_locked("run") && is_locked(".run"));
        std::fs::remove_dir_all(base.join("run")).unwrap();
        keep.tend();
        assert!(is_locked("run"), "the restored folder, too");
        drop(keep);
        assert!(!is_locked("run"));
        std::fs::remove_dir_all(base).unwrap();
    }
}
