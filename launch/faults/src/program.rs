//! The programs of a fault run: this one and `stgdat`.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use console::failure::Failure;
use console::siblings::{self, STGDAT_VARIABLE};
use supervisor::die_with_this_process;

/// The name of the program under test.
const STGDAT: &str = "stgdat";

/// The file of `stgdat`: the program that the user has called, or else the one beside this program or in PATH.
pub fn stgdat_path() -> PathBuf {
    std::env::var_os(STGDAT_VARIABLE).map_or_else(|| siblings::find(STGDAT), PathBuf::from)
}

/// A command that starts `stgdat`. The process dies with this one.
pub fn stgdat() -> Command {
    mortal(stgdat_path())
}

/// A command that starts this program again. The process dies with this one.
pub fn this_program() -> Command {
    mortal(supervisor::this_program())
}

/// Starts `stgdat`.
pub fn start_stgdat(command: &mut Command) -> Result<Child, Failure> {
    command.spawn().map_err(|error| siblings::not_started(STGDAT, "", error))
}

fn mortal(program: PathBuf) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null());
    die_with_this_process(&mut command);
    command
}
