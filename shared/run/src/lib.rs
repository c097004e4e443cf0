//! What a run is: the record that every stage is started with, what a stage declares of itself, and the exit codes.
//!
//! [`Run`] is everything that all stages of one run must agree on (where its shared memory lies, which weights); the
//! launcher writes it once and every stage reads it. What concerns one stage alone are its *options*: a table of TOML in
//! the run's record, which that stage reads as a struct of its own.
//!
//! A stage says in one constant, its [`Declaration`], which stage it is, which topics it reads and writes, and which
//! struct holds its options. The struct's fields, their documentation, defaults and ranges are all that is known of an
//! option anywhere: pipeline.toml and the command line are checked by it, and `stgdat stage --help` is made of it.

mod declaration;
mod exit;
pub mod options;
mod record;

pub use declaration::{Conflict, Declaration, Declared, NoOptions, OptionError};
pub use exit::Exit;
pub use record::{MAGIC, RecordError, Run, SCHEMA, StageRun};
