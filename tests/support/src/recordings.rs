use std::path::{Path, PathBuf};

/// The folder of public recordings: `$STGDAT_DATA`, or else `shared/data` beside the repository.
#[must_use]
pub fn recordings_folder() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    std::env::var_os("STGDAT_DATA").map_or_else(beside, PathBuf::from)
}

/// A file or folder among the public recordings; `None` if it is missing, and the test is listed as skipped.
///
/// # Panics
/// If it is missing and `STGDAT_REQUIRE_DATA=1` is set.
#[must_use]
pub fn public_recording(name: &str) -> Option<PathBuf> {
    let path = recordings_folder().join(name);
    if path.exists() {
        return Some(path);
    }
    let is_required = std::env::var_os("STGDAT_REQUIRE_DATA").is_some_and(|value| value == "1");
    assert!(!is_required, "STGDAT_REQUIRE_DATA=1, and no recording at {}", path.display());
    crate::skip(format_args!("no recording at {}", path.display()));
    None
}
