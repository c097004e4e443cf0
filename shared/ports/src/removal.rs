//! The end of a run's files.

use std::path::Path;

use crate::places::{files_of, is_ours, lock_path, seconds_of};

/// Removes a run's files, the lock last: while the lock is held, no other process takes the files for
/// leftovers.
pub(crate) fn remove(name: &str, root: Option<&Path>) {
    let lock = lock_path(name);
    for file in files_of(name).into_iter().filter(|file| *file != lock) {
        let _ = std::fs::remove_file(file);
    }
    for root in root.iter().filter(|root| is_ours(root)) {
        let _ = std::fs::remove_dir_all(root);
    }
    for second in root.map(seconds_of).unwrap_or_default() {
        let _ = std::fs::remove_dir_all(second);
    }
    if is_ours(&lock) {
        let _ = std::fs::remove_file(lock);
    }
}
