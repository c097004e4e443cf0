//! The tap of a run: one process that reads the topics and forwards the frames to all tools of the run.
//!
//! The launcher starts the tap with the stages. Through the tap's standard input, the launcher reports the
//! stages' events and output lines. The tap takes a reader's place on a topic only while a tool needs the
//! topic. Without tools it sleeps.

mod flight;
mod follow;
mod process;
mod ring_arguments;
mod server;
mod topic;

pub use flight::FlightRecorder;
pub use follow::{Recorded, follow};
pub use process::{Recording, Tap, TapMessages};
pub use ring_arguments::RingArguments;
pub use server::serve;
