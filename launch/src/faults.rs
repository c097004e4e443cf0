//! Fault injection: the faults that a specification injects into a run, and the behaviour that it expects.
//!
//! [`spec`] reads the specification. [`runner`] starts `stgdat run` in a separate process. It also starts a
//! follower, which writes the history of the forecasts, and one injector per faulty topic. The topic's writer
//! opens the topic under another name, and the injector forwards the frames with faults. [`verdict`] compares
//! the history, the report and the injected faults with the expectation.

pub mod effect;
pub mod follow;
pub mod inject;
mod observation;
pub mod output;
mod plan;
pub mod processes;
pub mod runner;
pub mod scenarios;
pub mod spec;
pub mod table;
pub mod verdict;
