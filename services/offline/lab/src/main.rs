//! `stgdat-lab` trains and evaluates models, draws pictures, builds maps and injects faults. None of it runs on a
//! vehicle.
//!
//! Each verb is a module of [`verbs`]. `stgdat VERB` runs this program for them.

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod contenders;
mod gallery;
mod picture;
mod published;
#[cfg(test)]
mod tests;
mod verbs;

use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use console::program::{self, GlobalArguments};
use verbs::Verb;

/// Training, evaluation, pictures, maps and fault injection for stgdat; nothing of this runs on a vehicle.
#[derive(Debug, Parser)]
#[command(name = "stgdat-lab", version)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    global: GlobalArguments,
}

fn main() -> ExitCode {
    program::begin();
    let parsed = Cli::command().try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = parsed.unwrap_or_else(|error| program::exit(&error));
    program::end(cli.global.apply().and_then(|()| cli.verb.execute()))
}
