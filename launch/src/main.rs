//! `stgdat`: starts and supervises the pipeline, and has verbs for data, models and diagnosis.
//!
//! Each verb is a module of [`verbs`]. `stgdat` without a verb is `stgdat run`.

mod arguments;
mod awake;
mod child;
mod cleaner;
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
mod policy;
mod prediction;
mod readers;
mod recorded;
mod report_differences;
mod runs;
mod scheduling;
mod show;
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

use clap::Parser;
use clap::builder::{PossibleValuesParser, TypedValueParser};
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
}

/// The instruction sets by their keys, without those that this processor lacks.
fn instruction_set() -> impl TypedValueParser<Value = Isa> {
    PossibleValuesParser::new(Isa::ALL.map(Isa::key)).try_map(|key| key.parse::<Isa>())
}

fn main() -> ExitCode {
    ports::begin_logging();
    let cli = Cli::parse();
    options::warn_of_old_flags(std::env::args_os());
    if let Some(Err(error)) = cli.kernels.map(kernels::force) {
        let failure = failure::Failure::Usage(error.to_string());
        failure.print();
        return failure.exit().into();
    }
    if cli.version {
        print!("{}", version::text());
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
