//! The other programs of this project: they lie in this program's folder or in PATH.

use std::ffi::OsString;
use std::io::{Error, ErrorKind};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::failure::Failure;

/// The variable in which `stgdat` names its own file to the program that replaces it.
pub const STGDAT_VARIABLE: &str = "STGDAT_PROGRAM";

/// Replaces this process by another program of this project with these arguments. Returns only if it can't:
/// with the build command, whose options are `options`, if the program is missing.
pub fn replace_by(name: &str, options: &str, arguments: impl Iterator<Item = OsString>) -> Failure {
    let mut command = Command::new(find(name));
    if let Some(own) = std::env::current_exe().ok().filter(|own| own.is_file()) {
        command.env(STGDAT_VARIABLE, own);
    }
    let error = command.args(arguments).exec();
    not_started(name, options, error)
}

/// The file of a program of this project; its name alone if it is not in this program's folder.
#[must_use]
pub fn find(name: &str) -> PathBuf {
    let found = std::env::current_exe().ok().and_then(|program| in_folder_of(&program, name));
    found.unwrap_or_else(|| name.into())
}

/// The failure of a program of this project that was not started; `options` are those of its build command.
#[must_use]
pub fn not_started(name: &str, options: &str, error: Error) -> Failure {
    match error.kind() {
        ErrorKind::NotFound => Failure::unavailable(format!(
            "`{name}`, which this verb needs, is neither beside this program nor in PATH; build it with \
             `cargo build --release --package {name}{options}`"
        )),
        _ => Failure::unavailable_about(find(name).display(), error),
    }
}

fn in_folder_of(program: &Path, name: &str) -> Option<PathBuf> {
    Some(program.with_file_name(name)).filter(|found| found.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_is_found_in_the_folder_of_this_one() {
        let folder = tempfile::tempdir().unwrap();
        let (program, other) = (folder.path().join("stgdat"), folder.path().join("stgdat-lab"));
        assert_eq!(in_folder_of(&program, "stgdat-lab"), None);
        std::fs::create_dir(&other).unwrap();
        assert_eq!(in_folder_of(&program, "stgdat-lab"), None, "a folder is no program");
        std::fs::remove_dir(&other).unwrap();
        std::fs::write(&other, "").unwrap();
        assert_eq!(in_folder_of(&program, "stgdat-lab"), Some(other));
    }
}
