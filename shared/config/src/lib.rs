//! The graph of stages, as a pipeline.toml tells it.
//!
//! [`Pipeline`] is the content of the file, checked as a whole: what it accepts can be started. What this project's own
//! programs read and write and which options they have, it takes from their declarations ([`run::Declared`]).

mod pipeline;

pub use pipeline::{BUDGET_MAX_MS, Pipeline, PipelineError, Stage};
