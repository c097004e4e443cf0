//! Fault injection: the faults that a specification injects into a run, and the behaviour that it expects.
//!
//! [`Verb`] has the verbs of `stgdat fault`. `spec` reads a specification. `runner` starts `stgdat run` in a
//! separate process. It also starts a follower, which writes the history of the forecasts, and one injector per
//! faulty topic. The topic's writer opens the topic under another name, and the injector forwards the frames with
//! faults. `verdict` compares the history, the report and the injected faults with the expectation.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! command  fuzz         the verbs; random specifications and histories
//! output  table         verdicts as text; the cost of deaths and stops of each stage
//! runner                one run with its faults
//! verdict               whether a run met its expectations
//! observation  plan  processes  scenarios    what a run did; its pipeline and arguments; its processes
//! spec  inject          the specification; the process between the writer and the readers of a topic
//! follow  substitute    the process that writes the history; programs that die in place of a stage
//! effect  checker       changes of frames; the rules for a history
//! program               the programs that are started
//! ```

mod checker;
mod command;
mod effect;
mod follow;
#[cfg(test)]
mod fuzz;
mod inject;
mod observation;
mod output;
mod plan;
mod processes;
mod program;
mod runner;
mod scenarios;
mod spec;
mod substitute;
mod table;
mod verdict;

pub use command::Verb;
