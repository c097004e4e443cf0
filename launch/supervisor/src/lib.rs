//! Supervision of a run: starts the processes of the stages, watches them, starts them again after a death,
//! replaces them, and ends them.
//!
//! [`Fleet::tend`] is the centre. The launcher calls it at least every 50 ms. One call
//!
//! 1. finds the processes that have ended, and asks `policy` whether each is started again;
//! 2. examines stages that send no heartbeats (`health`), and kills those that hang or are stopped;
//! 3. starts the stages that are due, once their dead predecessors are cleaned up (`cleaner`).
//!
//! **Nothing here waits without a limit.** Programs are started by another thread within a time limit (`spawn`).
//! Output passes through queues with a limit (`outlet`), and the output of the stages is read by a thread of its
//! own (`stage_output`). A process that can't be killed is reported and left behind.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! fleet                 the processes of a run: tend, replace, spares, end
//! readers               deaths of readers that are not stages
//! cleaner               the clean-up after dead processes
//! child                 one process of a stage
//! control  spawn  stage_output    orders; starts within a limit; the output of the stages
//! policy  processes     when a stage is started again; use of CPU and memory
//! health  restart  scheduling  outlet  text  program
//! error
//! ```

mod child;
mod cleaner;
pub mod control;
mod error;
mod fleet;
mod health;
mod outlet;
mod policy;
mod processes;
mod program;
mod readers;
mod restart;
pub mod scheduling;
mod spawn;
mod stage_output;
mod text;

pub use child::{KILL_LIMIT, Program, die_with_this_process, end_within};
pub use cleaner::line as helper_line;
pub use error::{Cause, Error, StageDeath, cause_about};
pub use fleet::{CheckOptions, Event, Fleet, Process, Replaced, Settings, StageSettings};
pub use health::look;
pub use outlet::{BYTES_MAX as QUEUE_BYTES_MAX, Origin, Outlet, Queue};
pub use processes::{Usage, Used, children, memory};
pub use program::this_program;
pub use restart::{Restart, RestartPolicy};
pub use scheduling::Scheduling;
pub use spawn::spawn;
pub use stage_output::Sink;
pub use text::{message, parse, plain};
