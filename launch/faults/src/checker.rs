//! Checks from a run's history whether the run has kept its promises. The history contains every output,
//! every event of the supervisor and every injected fault.
//!
//! The checker shares only the payloads with the pipeline. It observes the decisions of the stages from
//! outside: which forecast is held, when a tick is lost, which stage is restarted. A [history](Line) is a
//! JSON line per observation during the run, and ends with the run's own report. [`check()`] compares the
//! observations with the report.

mod check;
mod history;

pub use check::{Finding, Promise, check};
pub use history::{Facts, ForecastSeen, Line, Outage, Output, read};

#[cfg(test)]
mod tests;
