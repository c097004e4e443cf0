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

/// Arguments that `stgdat-lab` reads.
#[derive(Debug, Args)]
pub struct Arguments {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<OsString>,
}

impl Verb {
    /// Replaces this process by `stgdat-lab` with the same arguments.
    ///
    /// # Errors
    /// [`Failure::Unavailable`] with the build command, if the program is neither in this program's folder
    /// nor in PATH.
    pub fn execute(&self) -> Result<Exit, Failure> {
        let beside = std::env::current_exe().ok().and_then(|program| lab_beside(&program));
        let program = beside.unwrap_or_else(|| PROGRAM.into());
        let error = Command::new(&program).args(std::env::args_os().skip(1)).exec();
        Err(match error.kind() {
            ErrorKind::NotFound => Failure::unavailable(format!(
                "`{PROGRAM}`, which has this verb, is neither beside stgdat nor in PATH; build it with \
                 `cargo build --release --package {PROGRAM}`"
            )),
            _ => Failure::unavailable_about(program.display(), error),
        })
    }
}

/// Returns the laboratory program in the folder of this program, if it exists.
fn lab_beside(program: &Path) -> Option<PathBuf> {
    Some(program.with_file_name(PROGRAM)).filter(|lab| lab.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_laboratory_is_found_beside_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("stgdat");
        assert_eq!(lab_beside(&program), None);
        std::fs::create_dir(folder.path().join(PROGRAM)).unwrap();
        assert_eq!(lab_beside(&program), None, "a folder is no program");
        std::fs::remove_dir(folder.path().join(PROGRAM)).unwrap();
        std::fs::write(folder.path().join(PROGRAM), "").unwrap();
        assert_eq!(lab_beside(&program), Some(folder.path().join(PROGRAM)));
    }
}
