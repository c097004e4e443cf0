//! Folders for temporary files.

use std::io;
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};

use crate::places::{create_private, random};

/// A folder with a random name that only this user can open, in the system's folder for temporary files. It
/// is removed when dropped.
#[derive(Debug)]
pub struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    /// Creates a folder whose name starts with `prefix`.
    ///
    /// # Errors
    /// If the folder can't be created.
    pub fn create(prefix: &str) -> io::Result<Self> {
        let folder = std::env::temp_dir().join(format!("{prefix}{:016x}", random()?));
        create_private(&folder)
            .map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", folder.display())))?;
        Ok(Self(folder))
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Keeps the folder. Returns its path.
    #[must_use]
    pub fn keep(self) -> PathBuf {
        ManuallyDrop::new(self).0.clone()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt as _;

    use super::*;

    #[test]
    fn a_folder_is_private_and_removed_unless_it_is_kept() {
        let folder = TemporaryFolder::create("stgdat-test-").unwrap();
        let path = folder.path().to_owned();
        assert_eq!(std::fs::metadata(&path).unwrap().mode() & 0o777, 0o700);
        drop(folder);
        assert!(!path.exists());
        let kept = TemporaryFolder::create("stgdat-test-").unwrap().keep();
        assert!(kept.is_dir());
        std::fs::remove_dir(kept).unwrap();
    }
}
