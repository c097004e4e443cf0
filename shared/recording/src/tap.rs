//! The tap: one process of a run reads the topics and hands the frames on to all tools of the run.
//!
//! A tool attaches to the socket [`SOCKET`] in the run's folder with a [`Request`] and gets [`Item`]s until the
//! run ends. Each tool has a bounded queue at the tap ([`QUEUE_BYTES`]); a tool that is slow loses frames there,
//! which are counted and told to it with the next frame that it gets ([`Item::Lost`]), and nobody else loses
//! anything. A tool that comes or goes touches no stage.
//!
//! [`Hub`] is the tap's side without sockets and topics, [`Client`] the tool's side.

mod client;
mod hub;
mod protocol;

pub use client::{Client, TapError};
pub use hub::{Hub, QUEUE_BYTES, TOOLS_MAX, Tool};
pub use protocol::{Item, Lost, LostAt, Marked, REQUEST_BYTES_MAX, Request, SOCKET, Want, refused};
