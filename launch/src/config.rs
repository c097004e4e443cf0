//! The graph of stages in a pipeline.toml.
//!
//! [`Pipeline`] is the content of the file, checked as a whole. An accepted file can be started. The topics
//! and options of this project's own programs come from their declarations ([`run::Declared`]).

mod pipeline;
mod scheduling;

pub use pipeline::{BUDGET_MAX_MS, Pipeline, Stage};
pub use scheduling::Realtime;
pub use supervisor::{Restart, RestartPolicy, Scheduling};
