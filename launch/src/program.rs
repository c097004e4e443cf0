//! Common set-up and exit of `stgdat` and `stgdat-lab`.

use std::process::ExitCode;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ColorChoice};
use nn::kernels::{self, Isa};
use run::Exit;

use crate::color;
use crate::failure::Failure;

/// Arguments that every verb takes.
#[derive(Debug, Args)]
pub struct GlobalArguments {
    /// Instruction set of the kernels, which this processor must have; the fastest if not given
    #[arg(long, value_name = "SET", global = true, env = kernels::VARIABLE, value_parser = instruction_set())]
    kernels: Option<Isa>,
    /// Colours of the output: `auto` means on a terminal, unless the variable NO_COLOR is set
    #[arg(long, value_name = "WHEN", global = true, env = ports::COLOR_VARIABLE, value_parser = color::choices())]
    color: Option<ports::Color>,
}

impl GlobalArguments {
    /// Selects the kernels named on the command line.
    ///
    /// # Errors
    /// [`Failure::Usage`] if this processor lacks them.
    pub fn apply(&self) -> Result<(), Failure> {
        let forced = self.kernels.map_or(Ok(()), kernels::force);
        forced.map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Parses an instruction set by its key. Sets that this processor lacks are not offered.
fn instruction_set() -> impl TypedValueParser<Value = Isa> {
    PossibleValuesParser::new(Isa::ALL.map(Isa::key)).try_map(|key| key.parse::<Isa>())
}

/// Chooses colours by the command line and the environment, and starts the log. Returns clap's colour choice.
#[must_use]
pub fn begin() -> ColorChoice {
    let color = color::choose(std::env::args_os());
    ports::begin_logging(color);
    color::for_clap(color)
}

/// Prints the failure of a verb, if any, and returns the exit code.
#[must_use]
pub fn end(outcome: Result<Exit, Failure>) -> ExitCode {
    outcome
        .unwrap_or_else(|failure| {
            failure.print();
            failure.exit()
        })
        .into()
}
