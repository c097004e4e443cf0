//! Remains of processes that were killed while they created a connection or a service.

use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::places::files_of;

/// The folder in a run's directory that holds the descriptions of its services.
const SERVICES: &str = "services";

/// Removes the connections of a run that have been empty for longer than `age`; returns their number. A
/// process that is killed while it creates a connection leaves an empty one, and clean-up would wait forever
/// for it to be finished.
#[must_use]
pub fn remove_half_made_connections(prefix: &str, age: Duration) -> usize {
    let is_half_made = |file: &&PathBuf| {
        file.extension().is_some_and(|extension| extension == "connection")
            && std::fs::metadata(file).is_ok_and(|metadata| metadata.len() == 0 && is_older(&metadata, age))
    };
    let files = files_of(prefix.trim_end_matches('_'));
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

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt as _;
    use std::time::SystemTime;

    use super::*;

    #[test]
    fn half_made_services_alone_are_removed_once_they_are_old() {
        let root = std::env::temp_dir().join(format!("stgdat_half_made_{}", std::process::id()));
        let services = root.join(SERVICES);
        std::fs::create_dir_all(&services).unwrap();
        for (name, mode) in [("whole.service", 0o400), ("half.service", 0o600)] {
            std::fs::write(services.join(name), "x").unwrap();
            let second_ago = SystemTime::now() - Duration::from_secs(1);
            std::fs::File::open(services.join(name)).unwrap().set_modified(second_ago).unwrap();
            std::fs::set_permissions(services.join(name), Permissions::from_mode(mode)).unwrap();
        }
        let young = remove_half_made_services(&root, Duration::from_secs(3_600));
        let old = remove_half_made_services(&root, Duration::ZERO);
        let is_left = ["whole.service", "half.service"].map(|name| services.join(name).exists());
        std::fs::remove_dir_all(&root).unwrap();
        assert_eq!((young, old, is_left), (0, 1, [true, false]));
        assert_eq!(remove_half_made_services(&root, Duration::ZERO), 0, "a run that is gone has none");
    }
}
