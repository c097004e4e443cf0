//! The files of a run: names in shared memory, a directory for sockets and records, and a lock that shows
//! whether the run is alive.
//!
//! The lock is in shared memory. A process that sees a run's shared memory can therefore see whether its
//! launcher is alive. A process number does not show this across containers.
//!
//! Another user of the machine can list the names, but open none of the files. It may also take names before
//! this process does:
//!
//! 1. A run whose name is taken gets another one.
//! 2. All names in shared memory that follow from others are random, or are created before anybody can know
//!    them ([`private`](crate::private)).

use std::fs::File;
use std::io::{self, Write as _};
use std::os::unix::ffi::OsStrExt as _;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags};
use thiserror::Error;

use crate::keep::Keep;
use crate::places::{
    SHARED_MEMORY, allocated, create_private, files_of, folders, is_private, is_safe, name_of, new_lock_path,
    random, shared_memory_free, take_lock,
};
use crate::private::create_global_segment;
use crate::removal::remove;
use crate::runs::leftovers;

/// The file in a run's directory that holds the run's record.
const RECORD: &str = "run";
/// Longest path of a run's directory, in bytes. The transport's sockets in it have names of up to 71 bytes,
/// and the path of a socket has at most 107.
const ROOT_BYTES_MAX: usize = 36;
/// Names that a new run tries.
const TRIES_MAX: usize = 64;

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
    /// Other users can replace the files of the folder.
    #[error("{}: other users can replace files in this folder: choose a folder of your own", .0.display())]
    Unsafe(PathBuf),
    /// The folder's path is too long for the sockets in it.
    #[error("{}: the path of a run's folder has at most {ROOT_BYTES_MAX} bytes", .0.display())]
    TooLong(PathBuf),
    /// Another program takes every name.
    #[error("{TRIES_MAX} names for the run were taken: another program takes them, see {SHARED_MEMORY}")]
    Taken,
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
    id: u64,
    prefix: String,
    root: PathBuf,
    keep: Option<Keep>,
    /// Locked until the launcher ends, killed or not.
    lock: File,
}

impl Space {
    /// Creates the files of a new run in `folder`, by default in the folder that the environment names for
    /// running programs, or else in `/tmp`. Removes the files of dead runs of a folder that only this user
    /// can write.
    ///
    /// # Errors
    /// [`SpaceError`] if shared memory has less than `needed_bytes` free, or the files can't be created.
    pub fn create(folder: Option<&Path>, needed_bytes: u64) -> Result<Self, SpaceError> {
        let about = |path: &Path| {
            let path = path.to_owned();
            move |source| SpaceError::File { path, source }
        };
        let free = shared_memory_free().map_err(about(Path::new(SHARED_MEMORY)))?;
        if free < needed_bytes {
            return Err(SpaceError::Full {
                free_mib: free >> 20,
                needed_mib: needed_bytes.div_ceil(1 << 20),
            });
        }
        let folder = folder.map_or_else(|| folders().swap_remove(0), Path::to_path_buf);
        let folder = std::path::absolute(&folder).map_err(about(&folder))?;
        if !is_safe(&folder).map_err(about(&folder))? {
            return Err(SpaceError::Unsafe(folder));
        }
        // Only this user creates files in a private folder, so these are of a predecessor that was killed.
        if is_private(&folder) {
            for leftover in leftovers().map_err(about(&folder))?.into_iter().filter(|run| run.is_in(&folder))
            {
                tracing::info!("removes the files of {}, whose launcher was killed", leftover.name);
                leftover.remove();
            }
        }
        for _ in 0..TRIES_MAX {
            let id = random().map_err(about(&folder))?;
            let root = folder.join(name_of(id));
            if root.as_os_str().len() > ROOT_BYTES_MAX {
                return Err(SpaceError::TooLong(root));
            }
            match Self::with_id(id, root.clone()) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                made => return made.map_err(about(&root)),
            }
        }
        Err(SpaceError::Taken)
    }

    /// Creates the files of a run with this number.
    ///
    /// # Errors
    /// [`io::ErrorKind::AlreadyExists`] if one of the names is taken; then nothing is left.
    fn with_id(id: u64, root: PathBuf) -> io::Result<Self> {
        let name = name_of(id);
        create_private(&root)?;
        let lock = new_lock_path(&name).and_then(|path| make_lock(&path));
        let lock = lock.inspect_err(|_| drop(std::fs::remove_dir(&root)))?;
        let prefix = format!("{name}_{:08x}_", random()? as u32);
        let mut space = Self { id, prefix, root, keep: None, lock };
        space.lock.write_all(space.root.as_os_str().as_bytes())?;
        let second = space.root.with_file_name(format!(".{name}_{:08x}", random()? as u32));
        create_private(&second)?;
        space.keep = Some(Keep::begin(&space.root, &second, RECORD));
        create_global_segment(&space.prefix, &space.root)?;
        Ok(space)
    }

    /// Restores files of the run's directory that another program has removed because they looked old. It
    /// works once the run's record exists, and takes one system call if nothing is missing. Returns the
    /// number of restored files.
    pub fn tend(&mut self) -> usize {
        self.keep.as_mut().map_or(0, Keep::tend)
    }

    /// Whether removed files are being restored: a process that starts now may miss some.
    #[must_use]
    pub fn is_restoring(&self) -> bool {
        self.keep.as_ref().is_some_and(Keep::is_restoring)
    }

    /// Protects the current files of the run's directory.
    pub fn keep(&mut self) {
        if let Some(keep) = &mut self.keep {
            keep.take_in();
        }
    }

    /// The run's random number.
    #[must_use]
    pub const fn id(&self) -> u64 {
        self.id
    }

    /// Prefix of the names of the transport's shared memory.
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
        files_of(&name_of(self.id)).iter().map(|file| allocated(file)).sum()
    }
}

impl Drop for Space {
    fn drop(&mut self) {
        remove(&name_of(self.id), Some(&self.root));
        // The lock is released last, when its file's name has already been removed.
        let _ = &self.lock;
    }
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

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};

    use super::*;
    use crate::places::seconds_of;

    fn mode(path: &Path) -> u32 {
        std::fs::symlink_metadata(path).unwrap().mode() & 0o777
    }

    #[test]
    fn a_taken_name_is_never_used() {
        let folder = tempfile::tempdir().unwrap();
        let id = random().unwrap();
        let root = folder.path().join(name_of(id));
        std::fs::create_dir(&root).unwrap();
        assert_eq!(Space::with_id(id, root.clone()).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        std::fs::remove_dir(&root).unwrap();
        std::os::unix::fs::symlink("/nowhere", &root).unwrap();
        assert_eq!(Space::with_id(id, root.clone()).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        std::fs::remove_file(&root).unwrap();
        let space = Space::with_id(id, root.clone()).unwrap();
        assert_eq!(mode(&root), 0o700);
        assert!(files_of(&name_of(id)).iter().all(|file| mode(file) == 0o600));
        drop(space);
        assert!(!root.exists() && files_of(&name_of(id)).is_empty() && seconds_of(&root).is_empty());
    }

    #[test]
    fn a_killed_predecessor_is_cleaned_up_in_a_private_folder() {
        let folder = tempfile::tempdir().unwrap();
        let alive = Space::create(Some(folder.path()), 0).unwrap();
        let mut dead = Space::create(Some(folder.path()), 0).unwrap();
        let (name, root) = (name_of(dead.id), dead.root.clone());
        // As if the launcher was killed: the lock is free, and all files remain.
        dead.lock = File::open("/dev/null").unwrap();
        std::mem::forget(dead);
        let next = Space::create(Some(folder.path()), 0).unwrap();
        assert!(!root.exists() && files_of(&name).is_empty() && seconds_of(&root).is_empty());
        assert!(alive.root.exists() && next.root.exists());
    }

    #[test]
    fn a_folder_that_others_write_is_refused_unless_it_is_sticky() {
        let folder = tempfile::tempdir().unwrap();
        for (mode, is_used) in [(0o700, true), (0o755, true), (0o777, false), (0o770, false), (0o1777, true)]
        {
            std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(mode)).unwrap();
            let made = Space::create(Some(folder.path()), 0);
            assert_eq!(made.is_ok(), is_used, "{mode:o}: {made:?}");
        }
        let deep = folder.path().join("a-folder-whose-name-is-quite-long");
        std::fs::create_dir(&deep).unwrap();
        let error = Space::create(Some(&deep), 0).unwrap_err();
        assert!(matches!(error, SpaceError::TooLong(_)), "{error}");
    }
}
