//! The verbs of `stgdat-lab`, one module each.

mod card;
mod evaluate;
pub mod manual;
mod map;
mod plot;
mod train;

use clap::Subcommand;
use console::failure::Failure;
use faults::Verb as Fault;
use run::Exit;

/// A verb with its arguments.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Evaluate forecasts and baselines on test data
    Evaluate(Box<evaluate::Arguments>),
    /// Train weights on recordings
    Train(train::Arguments),
    /// Print the model card of weights
    Card(card::Arguments),
    /// Plot forecasts or learning curves as SVG or PNG
    Plot(plot::Arguments),
    /// Build the context map of a site from its recordings
    Map(map::Arguments),
    /// Inject faults into runs and check that the runs keep their guarantees
    #[command(subcommand)]
    Fault(Fault),
    /// Print the manual of both programs as Markdown: the page docs/cli.md
    #[command(hide = true)]
    Manual(manual::Arguments),
}

impl Verb {
    /// Executes the verb.
    pub fn execute(self) -> Result<Exit, Failure> {
        match self {
            Self::Evaluate(arguments) => evaluate::execute(&arguments),
            Self::Train(arguments) => train::execute(&arguments),
            Self::Card(arguments) => card::execute(&arguments),
            Self::Plot(arguments) => plot::execute(&arguments),
            Self::Map(arguments) => map::execute(&arguments),
            Self::Fault(verb) => verb.execute(),
            Self::Manual(arguments) => manual::execute(&arguments),
        }
    }
}
