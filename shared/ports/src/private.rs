//! The transport's only file in shared memory whose name follows from the prefix.
//!
//! The transport gives every other file a random number, and opens all of them for one user only. It creates
//! this file for all users (mode 0666). Another user could change it and so keep processes from starting.
//! Therefore the launcher writes the file itself, for one user, before any other file has the prefix. The
//! transport opens a file that is there.

use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

use iceoryx2::prelude::{NodeBuilder, SignalHandlingMode, ipc};

use crate::nodes::transport_config;
use crate::places::{SHARED_MEMORY, files_of, is_ours};

/// End of the file's name.
const SUFFIX: &str = ".global_mgmt";
/// The file's name without the prefix: a hash of the stored type's name, and the transport's version.
const NAME: &str = "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt";
/// The transport's version, 0.10.0: major, minor and patch in 16 bits each.
const VERSION: u64 = 10 << 16;
/// Bytes of the file: the version, the number of nodes so far, and padding.
const LEN: usize = 16;

/// Creates the file for this user only.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] if the file is there. Another error if the transport does not accept it.
pub(crate) fn create_global_segment(prefix: &str, root: &Path) -> io::Result<()> {
    let segment = Path::new(SHARED_MEMORY).join(format!("{prefix}{NAME}"));
    let mut content = [0; LEN];
    content[..8].copy_from_slice(&VERSION.to_ne_bytes());
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(segment)?.write_all(&content)?;
    join(prefix, root).map_err(io::Error::other)?;
    if !has_private_segment(prefix) {
        return Err(io::Error::other("the transport has another version than this program expects"));
    }
    Ok(())
}

/// Whether the transport's file is there, and no other user can open it.
pub(crate) fn has_private_segment(prefix: &str) -> bool {
    let is_private = |path: &PathBuf| {
        is_ours(path) && std::fs::symlink_metadata(path).is_ok_and(|found| found.mode() & 0o077 == 0)
    };
    let segments = global_segments(prefix);
    !segments.is_empty() && segments.iter().all(is_private)
}

fn global_segments(prefix: &str) -> Vec<PathBuf> {
    let ends = |path: &PathBuf| path.to_str().is_some_and(|path| path.ends_with(SUFFIX));
    files_of(prefix.trim_end_matches('_')).into_iter().filter(ends).collect()
}

/// Joins the run for a moment.
fn join(prefix: &str, root: &Path) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let builder = NodeBuilder::new().config(&transport_config(prefix, root)?);
    builder.signal_handling_mode(SignalHandlingMode::Disabled).create::<ipc::Service>()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::places::{name_of, random};
    use crate::removal::remove;

    /// The name of a run without processes. Its files are removed at the end.
    struct Prefix {
        name: String,
        root: tempfile::TempDir,
    }

    impl Prefix {
        fn new() -> Self {
            let name = name_of(random().unwrap());
            Self { name, root: tempfile::Builder::new().prefix("p").tempdir().unwrap() }
        }

        fn text(&self) -> String {
            format!("{}_", self.name)
        }
    }

    impl Drop for Prefix {
        fn drop(&mut self) {
            remove(&self.name, None);
        }
    }

    #[test]
    fn the_file_is_the_one_that_the_transport_creates() {
        let (theirs, ours) = (Prefix::new(), Prefix::new());
        join(&theirs.text(), theirs.root.path()).unwrap();
        create_global_segment(&ours.text(), ours.root.path()).unwrap();
        let read = |prefix: &Prefix| {
            let segment = global_segments(&prefix.text()).pop().unwrap();
            let name = segment.to_str().unwrap().split_once(&prefix.name).unwrap().1.to_owned();
            (name, std::fs::read(segment).unwrap())
        };
        // One node has joined each: the counters are equal too.
        assert_eq!(read(&ours), read(&theirs));
        assert!(has_private_segment(&ours.text()) && !has_private_segment(&theirs.text()));
        assert_eq!(global_segments(&ours.text()).len(), 1);
    }

    #[test]
    fn a_file_of_another_program_is_not_used() {
        let prefix = Prefix::new();
        let path = Path::new(SHARED_MEMORY).join(format!("{}{NAME}", prefix.text()));
        std::fs::write(&path, [0; LEN]).unwrap();
        let error = create_global_segment(&prefix.text(), prefix.root.path()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
    }
}
