//! The names and places of a run's files, and who owns them.
//!
//! | file | name |
//! |---|---|
//! | folder of the run | `FOLDER/stgdat_X` |
//! | second names of its files | `FOLDER/.stgdat_X_S` |
//! | lock | `/dev/shm/stgdat_X_L_lock` |
//! | shared memory | `/dev/shm/stgdat_X_R_…` |
//!
//! X, S, L and R are random, and each of them stays unknown until the first file with it exists. So no other
//! user, who can list all names, can take one of them in advance. A file counts only if this user owns it.

use std::ffi::OsStr;
use std::fs::{DirBuilder, File};
use std::io::{self, Read as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, Mode, OFlags, StatVfs, flock, fstat, open, statvfs};
use rustix::process::geteuid;
use rustix::rand::{GetRandomFlags, getrandom};

/// The directory that shows POSIX shared memory as files.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";
/// The folder of runs if the environment names none. Not `TMPDIR`: a socket's path must stay under 108 bytes.
const TEMPORARY: &str = "/tmp";
/// Environment variables that name a folder for the files of running programs: systemd sets the first one for
/// a service, and the second one for a user's session.
const RUNTIME_VARIABLES: [&str; 2] = ["RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR"];
/// Prefix of all names of all runs.
const FAMILY: &str = "stgdat_";
/// Digits of a run's name after [`FAMILY`].
const DIGITS: usize = 8;
const LOCK_SUFFIX: &str = "_lock";
/// Room that the start of a stage may need, in bytes and files.
const ROOM_BYTES: u64 = 2 << 20;
const ROOM_FILES: u64 = 64;
/// Longest path in a lock.
const PATH_BYTES_MAX: u64 = 4_096;

/// The name of the run with this number; the lower half of the number is public.
pub(crate) fn name_of(run_id: u64) -> String {
    format!("{FAMILY}{:0DIGITS$x}", run_id as u32)
}

/// The name of the run that a file or folder belongs to, by the file's name.
pub(crate) fn name_in(file: &str) -> Option<String> {
    let digits = file.strip_prefix('.').unwrap_or(file).strip_prefix(FAMILY)?.get(..DIGITS)?;
    digits.bytes().all(|b| b.is_ascii_hexdigit()).then(|| format!("{FAMILY}{digits}"))
}

/// A random number that nobody can predict.
pub(crate) fn random() -> io::Result<u64> {
    let mut bytes = [0; 8];
    getrandom(&mut bytes, GetRandomFlags::empty())?;
    Ok(u64::from_le_bytes(bytes))
}

/// The folders in which runs may have their own folders, the preferred one first.
pub(crate) fn folders() -> Vec<PathBuf> {
    let named = RUNTIME_VARIABLES.iter().filter_map(std::env::var_os);
    // systemd separates several directories by colons.
    let named = named.map(|list| list.to_str().and_then(|list| list.split(':').next()).map(PathBuf::from));
    // A variable may be inherited from another user, for instance through `sudo`.
    let usable = named.flatten().filter(|folder| folder.is_absolute() && is_ours(folder));
    usable.chain([TEMPORARY.into()]).collect()
}

/// Creates a folder that only this user can open.
///
/// # Errors
/// If something has that name already, or the folder can't be created.
pub(crate) fn create_private(folder: &Path) -> io::Result<()> {
    DirBuilder::new().mode(0o700).create(folder)
}

/// Whether no other user can replace or remove the entries of a folder.
pub(crate) fn is_safe(folder: &Path) -> io::Result<bool> {
    let found = std::fs::metadata(folder)?;
    let (is_sticky, others_write) = (found.mode() & 0o1000 != 0, found.mode() & 0o022 != 0);
    Ok([0, geteuid().as_raw()].contains(&found.uid()) && (is_sticky || !others_write))
}

/// Whether only this user and root can write a folder.
pub(crate) fn is_private(folder: &Path) -> bool {
    std::fs::metadata(folder)
        .is_ok_and(|found| found.uid() == geteuid().as_raw() && found.mode() & 0o022 == 0)
}

/// A new path for the lock of a run.
pub(crate) fn new_lock_path(name: &str) -> io::Result<PathBuf> {
    Ok(Path::new(SHARED_MEMORY).join(format!("{name}_{:08x}{LOCK_SUFFIX}", random()? as u32)))
}

/// The lock of a run of this user.
pub(crate) fn lock_path(name: &str) -> Option<PathBuf> {
    files_of(name).into_iter().find(|path| is_lock(path))
}

/// Whether a file in shared memory is the lock of a run.
pub(crate) fn is_lock(path: &Path) -> bool {
    path.to_str().is_some_and(|path| path.ends_with(LOCK_SUFFIX))
}

/// Takes the lock of a run.
pub(crate) fn take_lock(path: &Path, how: OFlags, lock: FlockOperation) -> io::Result<File> {
    let descriptor =
        open(path, OFlags::RDWR | OFlags::CLOEXEC | OFlags::NOFOLLOW | how, Mode::RUSR | Mode::WUSR)?;
    flock(&descriptor, lock)?;
    if fstat(&descriptor)?.st_nlink == 0 {
        // The file was removed between opening and locking.
        return Err(io::ErrorKind::NotFound.into());
    }
    Ok(descriptor.into())
}

/// The folder of a run: named in its lock. Without the lock it is searched in the usual places.
pub(crate) fn root_of(name: &str) -> Option<PathBuf> {
    if let Some(lock) = lock_path(name)
        && let Ok(file) = File::open(lock)
    {
        let mut text = String::new();
        let path = file.take(PATH_BYTES_MAX).read_to_string(&mut text).map(|_| PathBuf::from(text));
        return path.ok().filter(|path| path.file_name() == Some(OsStr::new(name)));
    }
    folders().into_iter().map(|folder| folder.join(name)).find(|root| is_ours(root))
}

/// The folders with the second names of the files in a run's folder.
pub(crate) fn seconds_of(root: &Path) -> Vec<PathBuf> {
    let (Some(folder), Some(name)) = (root.parent(), root.file_name().and_then(OsStr::to_str)) else {
        return Vec::new();
    };
    entries(folder, &format!(".{name}"))
}

/// This user's files of a run in shared memory.
pub(crate) fn files_of(name: &str) -> Vec<PathBuf> {
    entries(Path::new(SHARED_MEMORY), &format!("{name}_"))
}

/// This user's entries of a folder whose names start with `prefix`, sorted.
fn entries(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let named = entries.filter(|e| e.file_name().to_str().is_some_and(|name| name.starts_with(prefix)));
    let mut found: Vec<PathBuf> = named.map(|entry| entry.path()).filter(|path| is_ours(path)).collect();
    found.sort();
    found
}

/// Whether this user owns a file. A link counts by its own owner.
pub(crate) fn is_ours(path: &Path) -> bool {
    owner(path) == Some(geteuid().as_raw())
}

/// The user who owns a file.
pub(crate) fn owner(path: &Path) -> Option<u32> {
    std::fs::symlink_metadata(path).ok().map(|found| found.uid())
}

pub(crate) fn allocated(path: &Path) -> u64 {
    std::fs::symlink_metadata(path).map_or(0, |found| found.blocks() * 512)
}

/// Whether a stage of a run has no room to start: few bytes or files are left in shared memory or for the
/// run's folder.
#[must_use]
pub fn is_full(root: &Path) -> bool {
    [Path::new(SHARED_MEMORY), root].into_iter().any(|path| {
        statvfs(path).is_ok_and(|StatVfs { f_bavail, f_frsize, f_files, f_favail, .. }| {
            f_bavail * f_frsize < ROOM_BYTES || (f_files > 0 && f_favail < ROOM_FILES)
        })
    })
}

/// Free bytes in shared memory.
///
/// # Errors
/// If there is no shared memory.
pub fn shared_memory_free() -> io::Result<u64> {
    let StatVfs { f_bavail, f_frsize, .. } = statvfs(SHARED_MEMORY)?;
    Ok(f_bavail * f_frsize)
}
