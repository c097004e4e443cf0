//! Recordings of runs: one MCAP file with the frames as they were sent, the supervisor's events, and the
//! stages' log lines.
//!
//! [`Writer`] writes the file and [`Recording`] reads it; neither depends on shared memory. The file is plain
//! [MCAP](https://mcap.dev/spec) (chunks of LZ4 frames, an index, check values). Other tools can therefore
//! list it, cut it and extract messages. [`Recording`] also reads the output of these tools: it parses
//! records with the crate `mcap`. In addition it recovers the intact parts of a torn or damaged file, which
//! that crate's readers refuse.
//!
//! Only the encoding of a frame is private to this project: the bytes of [`wire::Header`], followed by the
//! payload's elements as they are in shared memory. The schema of each topic is the output of `stgdat wire
//! --json`, which contains the offset of every field.
//!
//! A frame is read back byte for byte as it was written:
//!
//! ```
//! use recording::{About, Frame, Message, Recording, Writer};
//! use wire::{Header, Track, TracksTopic};
//!
//! let path = std::env::temp_dir().join(format!("recording-example-{}.mcap", std::process::id()));
//! let mut header = Header::new(7, 3, 240_000_000);
//! header.counts.agents_len = 1;
//! let track = Track { id: 4, x_m: 1.5, ..bytemuck::Zeroable::zeroed() };
//! let frame = Frame::of::<TracksTopic>(&header, &[track], 1_000);
//!
//! let mut writer = Writer::create(&path, &About::default(), "{}")?;
//! writer.frame(&frame);
//! writer.finish("the end")?;
//!
//! let recording = Recording::open(&path)?;
//! assert!(recording.is_complete());
//! let Some(Message::Frame(found)) = recording.messages().next().transpose()? else { panic!("no frame") };
//! assert_eq!((found.header().seq, found.elements::<TracksTopic>()?[0].x_m), (3, 1.5));
//! # std::fs::remove_file(path)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Ring`] keeps the newest messages in memory, and [`flight`] decides when they are worth a file.
//! [`Before`] keeps the part of all earlier messages that a replay needs.
//!
//! [`tap`] gives tools the frames of a running pipeline: one process reads the topics and forwards them.

mod about;
mod bag;
mod before;
mod compare;
mod error;
mod event;
pub mod flight;
mod format;
mod frame;
mod message;
mod reader;
mod ring;
mod sink;
pub mod tap;
#[cfg(test)]
mod tests;
mod view;
mod writer;

pub use about::{ABOUT, About};
pub use bag::{BagMessage, Damage, bag_messages, is_bag, is_end_of_bag, unpacked_file};
pub use before::{Before, Forgotten};
pub use compare::{Comparison, Difference, FrameDifference, TopicComparison, compare, computed};
pub use error::{ReadError, WriteError};
pub use event::{Event, Happened, LogLine};
pub use frame::{Frame, FrameError, lean, topic_number};
pub use message::Message;
pub use reader::{Ending, Messages, Recording};
pub use ring::{Ring, RingLimits};
pub use sink::{FileSink, Sink};
pub use view::{View, ViewChannel};
pub use writer::{CHUNK_BYTES, CHUNK_NS, Losses, Writer, Written};

/// Topic of the supervisor's events, JSON.
pub const EVENTS: &str = "events";
/// Name in [`About::topics`] of a recording without frames, events and log lines.
pub const NO_TOPIC: &str = "none";
/// Topic of the stages' log lines, JSON.
pub const LOG: &str = "log";
