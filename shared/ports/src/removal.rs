//! The end of a run's files.

use std::path::Path;

use crate::places::{files_of, is_lock, is_ours, seconds_of};

/// Removes a run's files, the lock last: while the lock is held, no other process takes the files for
/// leftovers.
pub(crate) fn remove(name: &str, root: Option<&Path>) {
    let (locks, others): (Vec<_>, Vec<_>) = files_of(name).into_iter().partition(|file| is_lock(file));
    for file in others {
        let _ = std::fs::remove_file(file);
    }
    for root in root.iter().filter(|root| is_ours(root)) {
        let _ = std::fs::remove_dir_all(root);
    }
    for second in root.map(seconds_of).unwrap_or_default() {
        let _ = std::fs::remove_dir_all(second);
    }
    for lock in locks {
        let _ = std::fs::remove_file(lock);
    }
}
