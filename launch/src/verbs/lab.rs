use std::ffi::OsString;
use std::io::ErrorKind;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::{Args, Subcommand};
use run::Exit;

use crate::failure::Failure;

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

/// Replaces this process by another program of this project with these arguments. Returns only if it can't:
/// with the build command, whose options are `options`, if the program is neither in this program's folder
/// nor in PATH.
pub fn replace_by(name: &str, options: &str, arguments: impl Iterator<Item = OsString>) -> Failure {
    let found = std::env::current_exe().ok().and_then(|program| beside(&program, name));
    let program = found.unwrap_or_else(|| name.into());
    let error = Command::new(&program).args(arguments).exec();
    match error.kind() {
        ErrorKind::NotFound => Failure::unavailable(format!(
            "`{name}`, which has this verb, is neither beside stgdat nor in PATH; build it with \
             `cargo build --release --package {name}{options}`"
        )),
        _ => Failure::unavailable_about(program.display(), error),
    }
}

/// Returns the program of this name in the folder of this program, if it exists.
fn beside(program: &Path, name: &str) -> Option<PathBuf> {
    Some(program.with_file_name(name)).filter(|found| found.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_laboratory_is_found_beside_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("stgdat");
        assert_eq!(beside(&program, PROGRAM), None);
        std::fs::create_dir(folder.path().join(PROGRAM)).unwrap();
        assert_eq!(beside(&program, PROGRAM), None, "a folder is no program");
        std::fs::remove_dir(folder.path().join(PROGRAM)).unwrap();
        std::fs::write(folder.path().join(PROGRAM), "").unwrap();
        assert_eq!(beside(&program, PROGRAM), Some(folder.path().join(PROGRAM)));
    }
}
