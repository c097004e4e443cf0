//! The program `stgdat`: starts and supervises the pipeline, plays recordings and diagnoses runs.
//!
//! Each verb is a module of `verbs`. `stgdat` without a verb is `stgdat run`. `stgdat-lab`, the laboratory,
//! has the verbs that a vehicle does not need. Its command line uses the public modules of this library.

// These panic on a closed pipe; `say!` and the log do not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod arguments;
mod awake;
mod differences;
mod fail_if;
pub mod files;
pub mod pages;
mod play_report;
mod prediction;
mod recorded;
mod report_differences;
pub mod runs;
mod saved_state;
pub mod tracking;
mod verbs;
mod version;
mod view_arguments;

use std::process::ExitCode;

use clap::{Command, CommandFactory as _, FromArgMatches as _, Parser, Subcommand as _};

use console::program::{self, GlobalArguments};
use console::say;

/// Items for benchmarks.
pub mod bench {
    pub use crate::verbs::bench::{machine, percentile};
}

/// Onboard multi-agent tracking and prediction: detections in, forecasts out, as a pipeline of processes.
#[derive(Debug, Parser)]
#[command(name = "stgdat", args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    verb: Option<verbs::Verb>,
    #[command(flatten)]
    run: verbs::run::Arguments,
    /// Print the version, the SHA-256 of the embedded weights and the CPU kernels in use
    #[arg(short = 'V', long)]
    version: bool,
    #[command(flatten)]
    global: GlobalArguments,
}

/// The command line of `stgdat`.
#[must_use]
pub fn command() -> Command {
    Cli::command()
}

/// The entry point of `stgdat`.
#[must_use]
pub fn main() -> ExitCode {
    program::begin();
    let arguments = program::verb_first(std::env::args_os().collect(), verbs::Verb::has_subcommand);
    let parsed =
        command().try_get_matches_from(arguments).and_then(|matches| Cli::from_arg_matches(&matches));
    let may_be_mistaken = match &parsed {
        Ok(cli) => cli.verb.is_none() && !cli.version,
        Err(error) => error.use_stderr(),
    };
    let mistaken = std::env::args()
        .nth(1)
        .filter(|_| may_be_mistaken)
        .and_then(|word| verbs::mistaken(&word, command()));
    if let Some(failure) = mistaken {
        return program::end(Err(failure));
    }
    let cli = parsed.unwrap_or_else(|error| program::exit(&error));
    let outcome = cli.global.apply().and_then(|()| match cli.verb {
        _ if cli.version => {
            say!("{}", version::text().trim_end());
            Ok(run::Exit::Done)
        }
        Some(verb) => verb.execute(command),
        None => verbs::run::execute(&cli.run),
    });
    program::end(outcome)
}
