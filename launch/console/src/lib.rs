//! What the programs of this project share at the console: failures with their exit codes, the log, standard
//! streams, colours, tables and the terminal.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! program               set-up and exit of `stgdat` and `stgdat-lab`
//! show  siblings  tables    results of verbs; the other programs; tables in Markdown files
//! failure               failures of verbs: messages and exit codes
//! log  terminal         the log; a table or a whole screen
//! streams               standard streams of a process that must not wait
//! color  screen         colours; lines of styled text
//! mistake               mistakes in a text that a user wrote
//! ```

// These panic on a closed pipe; `say!` and the log do not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod color;
pub mod failure;
pub mod log;
pub mod mistake;
pub mod program;
pub mod screen;
pub mod show;
pub mod siblings;
pub mod streams;
pub mod tables;
pub mod terminal;
