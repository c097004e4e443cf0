//! The transport's only file in shared memory whose name follows from the prefix.
//!
//! The transport gives every other file a random number, and opens all of them for one user only. It creates
//! this file for all users (mode 0666). Another user could change it and so keep processes from starting.
//! Therefore the launcher creates it before any other file has the prefix, and puts a copy that nobody else
//! can open in its place.

use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use iceoryx2::prelude::{NodeBuilder, SignalHandlingMode, ipc};

use crate::nodes::transport_config;
use crate::places::{SHARED_MEMORY, files_of, is_ours, random};

/// End of the file's name.
const SUFFIX: &str = ".global_mgmt";

/// Creates the file for this user only.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if another user has changed the file before it was replaced.
pub(crate) fn create_global_segment(prefix: &str, root: &Path) -> io::Result<()> {
    join(prefix, root).map_err(io::Error::other)?;
    let segment = global_segment(prefix).ok_or(io::ErrorKind::AlreadyExists)?;
    let content = std::fs::read(&segment)?;
    let copy = Path::new(SHARED_MEMORY).join(format!("{prefix}{:016x}", random()?));
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&copy)?;
    file.write_all(&content)?;
    std::fs::rename(copy, segment)?;
    join(prefix, root).map_err(|_| io::ErrorKind::AlreadyExists.into())
}

/// Whether the file is there, and no other user can open it.
pub(crate) fn has_private_segment(prefix: &str) -> bool {
    global_segment(prefix).is_some_and(|path| {
        is_ours(&path) && std::fs::symlink_metadata(path).is_ok_and(|found| found.mode() & 0o077 == 0)
    })
}

fn global_segment(prefix: &str) -> Option<PathBuf> {
    let ends = |path: &PathBuf| path.to_str().is_some_and(|path| path.ends_with(SUFFIX));
    files_of(prefix.trim_end_matches('_')).into_iter().find(ends)
}

/// Joins the run for a moment.
fn join(prefix: &str, root: &Path) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let builder = NodeBuilder::new().config(&transport_config(prefix, root)?);
    builder.signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>()?;
    Ok(())
}
