//! Whether a run has kept its promises, by its history: every output, every event of the supervisor, every fault
//! that was injected.
//!
//! It shares no code with the pipeline but the payloads: what the stages decide (which forecast is held, when a tick
//! is lost, who is restarted) is looked at from outside. A [history](Line) has a line of JSON for each thing that was
//! seen while the run went on, and at its end what the run itself reports of it; [`check()`] holds one against the
//! other.

mod check;
mod history;

pub use check::{Finding, Promise, check};
pub use history::{ForecastSeen, HistoryError, Line, Outage, Output, Told, read};
