use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use console::say;
use run::Exit;

use crate::files::check_new;
use crate::pages::write_page;
use crate::recorded;

/// Arguments of `stgdat report`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Report of a run (`run --report`), or recording of a run (`run --record`)
    run: PathBuf,
    /// Another run to compare with the first
    other: Option<PathBuf>,
    /// HTML file to write; by default the first file's name with the extension html
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the HTML file if it exists
    #[arg(long)]
    force: bool,
}

/// Writes the report of one or two runs as an HTML page.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let path = arguments.out.clone().unwrap_or_else(|| arguments.run.with_extension("html"));
    check_new(&path, arguments.force)?;
    let files: Vec<&Path> =
        std::iter::once(&arguments.run).chain(&arguments.other).map(PathBuf::as_path).collect();
    let damages = write_page(&path, &files)?;
    if !recorder::is_standard_output(&path) {
        say!("{}", path.display());
    }
    recorded::end_with(damages)
}
