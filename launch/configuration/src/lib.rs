//! The configuration of a run: the graph of stages in a pipeline.toml, and the options of the stages.
//!
//! [`Pipeline`] is the content of the file, checked as a whole. An accepted file can be started. The topics
//! and options of this project's own programs come from their declarations ([`run::Declared`]).
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! options  pipeline_file    options of all stages with the settings of the command line; reads a pipeline.toml
//! pipeline  stages          the graph of stages; the list of the built-in stages
//! realtime                  settings of a whole run
//! ```

pub mod options;
mod pipeline;
pub mod pipeline_file;
mod realtime;
pub mod stages;

pub use pipeline::{BUDGET_MAX_MS, Pipeline, Stage};
pub use realtime::Realtime;
