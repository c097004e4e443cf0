//! The tap: one process of a run reads the topics and forwards the frames to all tools of the run.
//!
//! A tool attaches to the socket [`SOCKET`] in the run's folder with a [`Request`]. It receives [`Item`]s
//! until the run ends. Each tool has a bounded queue at the tap ([`QUEUE_BYTES`]). A slow tool loses frames
//! there. The tap counts them and reports them before the tool's next frame ([`Item::Lost`]). Other tools
//! lose nothing. Attaching and detaching a tool affects no stage.
//!
//! [`Hub`] is the tap's side without sockets and topics. [`Client`] is the tool's side.

mod client;
mod hub;
mod protocol;

pub use client::{Client, TapError};
pub use hub::{Hub, QUEUE_BYTES, TOOLS_MAX, Tool};
pub use protocol::{Item, Lost, LostAt, Marked, REQUEST_BYTES_MAX, Request, SOCKET, Want, refused};
