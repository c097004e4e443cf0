//! Recordings of runs: one MCAP file with the frames as they were sent, what the supervisor did, and the
//! stages' log lines.
//!
//! [`Writer`] makes the file and [`Recording`] reads it; neither knows shared memory. The file is plain
//! [MCAP](https://mcap.dev/spec) (chunks of LZ4 frames, an index, check values), so that other tools list it,
//! cut it and take messages out of it. [`Recording`] reads what these tools write: its records are those of
//! the crate `mcap`. Around them it recovers what is whole of a torn or damaged file, which that crate's
//! readers refuse. What is private to this project is the encoding of a frame: the bytes of [`wire::Header`]
//! followed by those of the payload's elements, as they lie in shared memory. The schema of each topic is the
//! document of `stgdat wire --json`, which has the offset of every field.
//!
//! A frame that is written is found again, byte for byte:
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
//! [`Ring`] keeps the newest messages in memory, and [`flight`] says when they are worth a file. [`Before`]
//! keeps of all that came before what a replay needs.
//!
//! [`tap`] is how tools get the frames of a run that goes on: one process reads the topics and hands them on.

mod about;
mod before;
mod compare;
mod error;
mod event;
pub mod flight;
mod format;
mod frame;
#[cfg(test)]
mod fuzz;
mod reader;
mod ring;
mod sink;
pub mod tap;
mod writer;

pub use about::{ABOUT, About};
pub use before::{Before, Forgotten};
pub use compare::{Comparison, Difference, FrameDifference, TopicComparison, compare, computed};
pub use error::{ReadError, WriteError};
pub use event::{Event, Happened, LogLine};
pub use frame::{Frame, FrameError, lean, topic_number};
pub use reader::{Ending, Message, Messages, Recording};
pub use ring::{Ring, RingLimits};
pub use sink::{FileSink, Sink};
pub use writer::{CHUNK_BYTES, CHUNK_NS, Losses, Writer, Written};

/// Topic of the supervisor's events, JSON.
pub const EVENTS: &str = "events";
/// Topic of the stages' log lines, JSON.
pub const LOG: &str = "log";
