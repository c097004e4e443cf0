//! Where detections come from: recordings of every known format, training windows, and generated scenes.
//!
//! A *recording* is a list of [`Frame`]s: what a sensor saw, and where known what was really there, at each time.
//! [`open`] reads one from a file together with the files that belong to it; [`parse`] does the same from bytes.
//! Positions come out in metres in one world frame, headings counter-clockwise in radians, stamps in nanoseconds on
//! the recording's own clock. What a row of a file means is told by the module of its format in [`formats`].
//!
//! [`tracks`] turns a recording with identities into trajectories, [`windows`](windows()) cuts those into strictly causal
//! histories and their futures, and [`sets`] names the files of the train, validation and test parts.
//!
//! [`TrackWriter`] writes what a tracker says of a recording.
//!
//! [`GeneratedScene`] needs no file: an intersection that lives for ever, with truth and a sensor's detections.

mod error;
mod format;
pub mod formats;
mod generated;
mod input;
mod open;
mod recording;
mod rows;
pub mod sets;
mod text;
mod track_file;
mod tracks;
mod windows;

pub use error::ReadError;
pub use format::{Format, UnknownFormat};
pub use generated::{FRAME_INTERVAL_NS, GeneratedScene, OptionError, SceneOptions};
pub use input::{FILE_BYTES_MAX, Input, Role};
pub use open::{open, parse};
pub use recording::{Ego, Frame, LeftOut, Recording};
pub use rows::ROWS_MAX;
pub use track_file::{TrackFormat, TrackRows, TrackWriter, UnknownTrackFormat};
pub use tracks::{RecordedTrack, Told, tracks, tracks_from_positions};
pub use windows::{Window, WindowAgent, WindowOptions, windows};
