//! The wire for programs in other languages: [`wire::TABLE`] as C, Python or JSON.

mod c;
mod json;
mod python;
mod text;

use clap::Args;
use run::Exit;

use console::failure::Failure;
use console::show::show;

/// Arguments of `stgdat wire`.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct Arguments {
    /// Print a header for C11 and C++17, `stgdat_wire.h`
    #[arg(long)]
    c: bool,
    /// Print a module for Python, `stgdat_wire.py`: ctypes structures, and dtypes if numpy is installed
    #[arg(long)]
    python: bool,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
}

/// Prints the wire.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let print = match arguments {
        Arguments { c: true, .. } => c::header,
        Arguments { python: true, .. } => python::module,
        Arguments { .. } => json::document,
    };
    show(&print(&::wire::TABLE))
}

/// The table as JSON: the layout of all frames.
pub fn layout() -> String {
    json::document(&::wire::TABLE)
}
