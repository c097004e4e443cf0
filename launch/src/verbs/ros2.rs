use std::ffi::OsString;

use clap::Args;
use run::Exit;

use super::lab::replace_by;
use crate::failure::Failure;

/// The program that executes this verb.
const PROGRAM: &str = "stgdat-ros2";

/// Arguments that `stgdat-ros2` reads.
#[derive(Debug, Args)]
pub struct Arguments {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<OsString>,
}

/// Replaces this process by `stgdat-ros2`, which links DDS.
pub fn execute(arguments: Arguments) -> Result<Exit, Failure> {
    Err(replace_by(PROGRAM, " --features ros2", arguments.arguments.into_iter()))
}
