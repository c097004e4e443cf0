//! `stgdat`: starts and supervises the pipeline, and has verbs for data, models and diagnosis.
//!
//! Each verb is a module of [`verbs`]. `stgdat` without a verb is `stgdat run`.

// These panic on a closed pipe; `say!` and `note!` do not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

#[macro_use]
mod show;

mod arguments;
mod awake;
mod child;
mod cleaner;
mod color;
mod contenders;
mod control;
mod differences;
#[cfg(test)]
mod docs;
mod fail_if;
mod failure;
mod faults;
mod fleet;
#[cfg(test)]
mod fuzz;
mod health;
mod memory;
mod observe;
mod options;
mod outages;
mod pipeline_file;
mod play_report;
mod policy;
mod prediction;
mod readers;
mod recorded;
mod report_differences;
mod runs;
mod scheduling;
mod stages;
mod tables;
mod tap;
mod top;
mod tracking;
mod verbs;
mod version;
mod watch;
mod waterfall;

use std::process::ExitCode;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use nn::kernels::{self, Isa};

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
    /// Instruction set of the kernels, which this processor must have; the fastest if not given
    #[arg(long, value_name = "SET", global = true, env = nn::kernels::VARIABLE, value_parser = instruction_set())]
    kernels: Option<Isa>,
    /// Colours of the output: `auto` means on a terminal, unless the variable NO_COLOR is set
    #[arg(long, value_name = "WHEN", global = true, env = ports::COLOR_VARIABLE, value_parser = color::choices())]
    color: Option<ports::Color>,
}

/// The instruction sets by their keys, without those that this processor lacks.
fn instruction_set() -> impl TypedValueParser<Value = Isa> {
    PossibleValuesParser::new(Isa::ALL.map(Isa::key)).try_map(|key| key.parse::<Isa>())
}

fn main() -> ExitCode {
    let color = color::choose(std::env::args_os());
    ports::begin_logging(color);
    let command = Cli::command().color(color::for_clap(color));
    let parsed = command.try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches));
    let may_be_mistaken = match &parsed {
        Ok(cli) => cli.verb.is_none() && !cli.version,
        Err(error) => error.use_stderr(),
    };
    let mistaken =
        std::env::args().nth(1).filter(|_| may_be_mistaken).and_then(|word| verbs::mistaken(&word));
    if let Some(failure) = mistaken {
        failure.print();
        return failure.exit().into();
    }
    let cli = parsed.unwrap_or_else(|error| error.exit());
    options::warn_of_old_flags(std::env::args_os());
    if let Some(Err(error)) = cli.kernels.map(kernels::force) {
        let failure = failure::Failure::Usage(error.to_string());
        failure.print();
        return failure.exit().into();
    }
    if cli.version {
        say!("{}", version::text().trim_end());
        return run::Exit::Done.into();
    }
    let outcome = match cli.verb {
        Some(verb) => verb.execute(),
        None => verbs::run::execute(&cli.run),
    };
    match outcome {
        Ok(exit) => exit.into(),
        Err(failure) => {
            failure.print();
            failure.exit().into()
        }
    }
}
