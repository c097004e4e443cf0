//! Fault injection: what a specification injects into a run, and what it expects of it.
//!
//! [`spec`] reads the specification. [`runner`] starts `stgdat run` as a process of its own and, beside it, a
//! follower that writes the history of the forecasts and an injector for each topic that a fault is on: the
//! topic's writer opens it under another name, and the injector passes the frames on, faulty. [`verdict`]
//! compares history, report and what was injected with what is expected.

pub mod effect;
pub mod follow;
pub mod inject;
pub mod output;
pub mod processes;
pub mod runner;
pub mod scenarios;
pub mod spec;
pub mod table;
pub mod verdict;
