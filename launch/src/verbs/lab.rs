use std::ffi::OsString;

use clap::{Args, Subcommand};
use run::Exit;

use console::failure::Failure;
use console::siblings::replace_by;

/// The program that executes these verbs.
const PROGRAM: &str = "stgdat-lab";

/// The verbs of `stgdat-lab`, which this program runs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Evaluate forecasts and baselines on recordings or data sets (stgdat-lab)
    #[command(disable_help_flag = true)]
    Evaluate(Arguments),
    /// Train weights on recordings (stgdat-lab)
    #[command(disable_help_flag = true)]
    Train(Arguments),
    /// Print the model card of weights (stgdat-lab)
    #[command(disable_help_flag = true)]
    Card(Arguments),
    /// Plot forecasts or learning curves as SVG or PNG (stgdat-lab)
    #[command(disable_help_flag = true)]
    Plot(Arguments),
    /// Build the context map of a site from its recordings (stgdat-lab)
    #[command(disable_help_flag = true)]
    Map(Arguments),
    /// Inject faults into runs and check that the runs keep their guarantees (stgdat-lab)
    #[command(disable_help_flag = true)]
    Fault(Arguments),
    /// Print the manual of the command lines as Markdown: the page docs/cli.md (stgdat-lab)
    #[command(hide = true, disable_help_flag = true)]
    Manual(Arguments),
}

/// Arguments that another program reads.
#[derive(Debug, Args)]
pub struct Arguments {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<OsString>,
}

impl Arguments {
    /// Replaces this process by a program that links more, or that another box needs without the rest.
    ///
    /// # Errors
    /// As [`replace_by`].
    pub fn execute(self, name: &str, options: &str) -> Result<Exit, Failure> {
        Err(replace_by(name, options, self.arguments.into_iter()))
    }
}

impl Verb {
    /// Replaces this process by `stgdat-lab` with the same arguments.
    ///
    /// # Errors
    /// [`Failure::Unavailable`] with the build command, if the program is neither in this program's folder
    /// nor in PATH.
    pub fn execute(&self) -> Result<Exit, Failure> {
        Err(replace_by(PROGRAM, "", std::env::args_os().skip(1)))
    }
}
