use std::ffi::OsString;

use clap::Args;
use run::Exit;

use super::lab::replace_by;
use crate::failure::Failure;

/// The program that executes this verb.
const PROGRAM: &str = "stgdat-bridge";

/// Arguments that `stgdat-bridge` reads.
#[derive(Debug, Args)]
pub struct Arguments {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<OsString>,
}

/// Replaces this process by `stgdat-bridge`, which another box needs without the rest.
pub fn execute(arguments: Arguments) -> Result<Exit, Failure> {
    Err(replace_by(PROGRAM, "", arguments.arguments.into_iter()))
}
