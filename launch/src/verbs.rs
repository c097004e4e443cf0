//! What can be asked of `stgdat`, one module each.

pub mod check;
pub mod clean;
pub mod completions;
pub mod doctor;
pub mod graph;
pub mod run;
pub mod stage;

use clap::Subcommand;
use config::Exit;

use crate::failure::Failure;

/// A verb with its arguments.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Start the pipeline, play a recording or a generated scene, report
    Run(run::Arguments),
    /// Be one stage of a run (`run` starts these)
    Stage(stage::Arguments),
    /// Check a pipeline.toml
    Check(check::Arguments),
    /// Print the graph of stages and topics
    Graph(graph::Arguments),
    /// Look at this machine: shared memory, limits, CPU, leftovers
    Doctor(doctor::Arguments),
    /// Remove what dead runs left in shared memory
    Clean(clean::Arguments),
    /// Print completions for a shell
    Completions(completions::Arguments),
}

impl Verb {
    /// Does it.
    pub fn execute(self) -> Result<Exit, Failure> {
        match self {
            Self::Run(arguments) => run::execute(&arguments),
            Self::Stage(arguments) => stage::execute(&arguments),
            Self::Check(arguments) => check::execute(&arguments),
            Self::Graph(arguments) => graph::execute(&arguments),
            Self::Doctor(arguments) => doctor::execute(&arguments),
            Self::Clean(arguments) => clean::execute(&arguments),
            Self::Completions(arguments) => completions::execute(&arguments),
        }
    }
}
