//! What a run is made of: the graph of stages, the record that every stage is started with, and the exit codes.
//!
//! [`Pipeline`] is the content of a pipeline.toml, checked as a whole: what it accepts can be started. [`Run`] is
//! everything that one run has settled on (which recording, which weights, where its shared memory lies); the launcher
//! writes it once and every stage reads it, so that no two of them can disagree.

mod exit;
mod options;
mod pipeline;
pub mod record;

pub use exit::Exit;
pub use options::{
    Association, MapChoice, Options, Prior, Propagation, UnknownAssociation, UnknownMap, UnknownPrior,
    UnknownPropagation, UnknownView, View,
};
pub use pipeline::{BUDGET_MAX_MS, Pipeline, PipelineError, Stage, built_in_topics};
pub use record::{Run, Scene, StageRun};
