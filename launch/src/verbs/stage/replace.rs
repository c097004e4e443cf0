use std::path::{Path, PathBuf};

use clap::Args;
use configuration::options;
use configuration::stages;
use console::failure::Failure;
use console::show::show;
use recorder::ReplacementOutcome;
use run::{Exit, Run};
use supervisor::control::{self, Answer, Order};

use crate::runs;

/// Arguments of `stgdat stage replace`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The stage
    #[arg(value_parser = stages::names())]
    name: String,
    /// Folder or record of the run; not needed if this user has only one
    #[arg(long, value_name = "PATH")]
    run: Option<PathBuf>,
    /// Set an option of the new process
    #[arg(long, value_name = "OPTION=VALUE")]
    set: Vec<String>,
    /// Program and arguments of the new stage, up to the end of the line; by default the built-in stage
    #[arg(long, value_name = "PROGRAM", num_args = 1.., allow_hyphen_values = true)]
    exec: Vec<String>,
}

/// Asks the launcher of a run to replace a stage, and prints the outcome.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let living = runs::find(arguments.run.as_deref())?;
    let run = Run::read(&living.root.join(ports::RECORD)).map_err(Failure::config)?;
    let order =
        Order { stage: arguments.name.clone(), command: command(&arguments.exec)?, options: set(arguments)? };
    let Answer { outcome, text } = control::order(&control::path(&run), &order)?;
    let text = format!("{}: {text}", living.name);
    match outcome {
        Some(ReplacementOutcome::Replaced) => {
            show(&format!("{text}\n"))?;
            Ok(Exit::Done)
        }
        _ => Err(Failure::Failed(text)),
    }
}

/// Returns the command with the program's absolute path, so it works from any folder. A program name that is
/// looked up in PATH stays unchanged.
fn command(words: &[String]) -> Result<Vec<String>, Failure> {
    let [program, arguments @ ..] = words else { return Ok(Vec::new()) };
    let program = if program.contains('/') {
        let path = Path::new(program);
        if !path.is_file() {
            return Err(Failure::file(path, std::io::Error::from(std::io::ErrorKind::NotFound)));
        }
        options::text(&options::absolute(path)?)?
    } else {
        program.clone()
    };
    Ok([&[program], arguments].concat())
}

/// Parses the options of the command line, with the stage's own schema if the program is built in.
fn set(arguments: &Arguments) -> Result<toml::Table, Failure> {
    let built_in = stages::declared().into_iter().find(|stage| stage.id().name() == arguments.name);
    let schema = built_in.filter(|_| arguments.exec.is_empty()).map(run::Declared::schema);
    let mut table = toml::Table::new();
    for setting in &arguments.set {
        let Some((key, value)) = setting.split_once('=') else {
            return Err(Failure::Usage(format!("--set {setting}: expected OPTION=VALUE")));
        };
        let option = schema.as_ref().and_then(|schema| schema.get(key));
        table.insert(key.to_owned(), options::value(value, option));
    }
    Ok(table)
}
