use clap::{Args, CommandFactory};
use clap_complete::Shell;
use config::Exit;

use crate::failure::Failure;

/// Arguments of `stgdat completions`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the completions.
#[expect(clippy::unnecessary_wraps, reason = "verbs have one form")]
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    clap_complete::generate(arguments.shell, &mut crate::Cli::command(), "stgdat", &mut std::io::stdout());
    Ok(Exit::Done)
}
