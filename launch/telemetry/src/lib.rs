//! What people and tools see of a run: the live table, `top`, metrics, traces, the tap, waterfalls, and the
//! reports to systemd.
//!
//! Everything here reads what the supervisor and the stages publish, and nothing here waits for a reader. Sockets
//! and files have their own threads and queues with a limit. The tap is a process of its own.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! watch                 follows a run from the launcher: its progress, its outages, its table
//! top                   the table of a run
//! observe               metrics, status and traces, and the sockets that serve them
//! outages  memory       cost of each death or replacement; page faults and locked memory
//! tap  waterfall  service    frames for tools; one tick as a chart; the reports to systemd
//! ```

// These panic on a closed pipe; `say!` and the log do not.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod memory;
pub mod observe;
pub mod outages;
pub mod service;
pub mod tap;
pub mod top;
pub mod watch;
pub mod waterfall;
