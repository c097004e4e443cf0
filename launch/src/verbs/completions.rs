use clap::{Args, Command};
use clap_complete::Shell;
use run::Exit;

use console::failure::Failure;
use console::show::show;

/// Arguments of `stgdat completions`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the completions.
pub fn execute(arguments: &Arguments, mut command: Command) -> Result<Exit, Failure> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "stgdat", &mut text);
    show(&String::from_utf8_lossy(&text))
}
