//! The wire for programs in other languages: what [`wire::TABLE`] holds, as C, Python or JSON.

mod c;
mod json;
mod python;
mod text;

use clap::Args;
use run::Exit;

use crate::failure::Failure;
use crate::show::show;

/// Arguments of `stgdat wire`.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct Arguments {
    /// A header for C11 and C++17, `stgdat_wire.h`
    #[arg(long)]
    c: bool,
    /// A module for Python, `stgdat_wire.py`: structures of ctypes, and dtypes where numpy is installed
    #[arg(long)]
    python: bool,
    /// The table itself
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
