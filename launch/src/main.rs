//! The program `stgdat`.

use std::process::ExitCode;

fn main() -> ExitCode {
    launch::main()
}
