//! `stgdat`: starts the pipeline, looks after it, and does what goes with it on the command line.
//!
//! Each verb is a module of [`verbs`]. `stgdat` without a verb is `stgdat run`.

mod arguments;
mod child;
mod contenders;
mod failure;
mod fleet;
mod options;
mod pipeline_file;
mod readme;
mod show;
mod stages;
mod tracking;
mod verbs;
mod version;
mod watch;

use std::process::ExitCode;

use clap::Parser;

/// Onboard multi-agent tracking and prediction: detections in, forecasts out, as a pipeline of processes.
#[derive(Debug, Parser)]
#[command(name = "stgdat", args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    verb: Option<verbs::Verb>,
    #[command(flatten)]
    run: verbs::run::Arguments,
    /// Print the version, the weights' fingerprint and the CPU kernels in use
    #[arg(short = 'V', long)]
    version: bool,
}

fn main() -> ExitCode {
    ports::begin_logging();
    let cli = Cli::parse();
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
            failure.tell();
            failure.exit().into()
        }
    }
}
