use std::path::{Path, PathBuf};

/// This program in the kernel's view: the file that runs, even after an upgrade has replaced it.
const RUNNING: &str = "/proc/self/exe";

/// The path that starts this program again, in the same version. The path by name is preferred because tools
/// show its name.
#[must_use]
pub fn this_program() -> PathBuf {
    use std::os::unix::fs::MetadataExt as _;
    let file = |path: &Path| std::fs::metadata(path).ok().map(|found| (found.dev(), found.ino()));
    let named = std::env::current_exe().ok();
    let is_running = |path: &PathBuf| file(path).is_some() && file(path) == file(Path::new(RUNNING));
    named.filter(is_running).unwrap_or_else(|| RUNNING.into())
}
