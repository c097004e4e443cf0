//! The tap of a run: one process that reads the topics and hands the frames on to all tools of the run.
//!
//! The launcher starts it with the stages and tells it, by its standard input, what happened to them and what they
//! wrote. It takes a reader's place of a topic only while a tool wants the topic; without tools it sleeps.

mod flight;
mod follow;
mod process;
mod ring_arguments;
mod server;
mod topic;

pub use flight::FlightRecorder;
pub use follow::{Recorded, follow};
pub use process::{Recording, Tap};
pub use ring_arguments::{Limits, RingArguments};
pub use server::serve;
