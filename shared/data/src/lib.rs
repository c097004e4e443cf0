//! Recordings of every known format, the windows for training and evaluation, and generated scenes.
//!
//! **In:** files in their published formats ([`Format`], one module each in [`formats`]), or the same bytes
//! in memory. **Out:** a [`Recording`], a list of [`Frame`]s in time order: the sensor's detections and, if
//! it is known, the truth. Positions are in metres in one right-handed world frame. Headings are in radians
//! counter-clockwise from +x, and speeds in m/s. Stamps are in nanoseconds on the recording's own clock.
//!
//! * [`open`] reads a recording from a file together with the files that belong to it. [`parse`] does the
//!   same from bytes. [`open_with`] and [`parse_at`] also take a frame rate. Bad input is a [`ReadError`]
//!   with file, line, column and value. No row is skipped silently.
//! * [`inspect`] audits a recording: rates, speeds and probable errors, with their lines.
//! * [`tracks`] joins detections with identities to trajectories. [`windows`](windows()) cuts trajectories
//!   into strictly causal histories (T_h steps) and futures (T_f steps, \[model §1\]).
//! * [`sets`] lists the files of the training, validation and test parts of each data set.
//! * [`TrackWriter`] writes a tracker's output as CSV, KITTI results or MOT rows.
//! * [`GeneratedScene`] needs no file: an endless intersection with truth and a sensor's detections.
//!
//! ```
//! use data::{Format, Input, Role, parse};
//!
//! let text = "stamp_s,id,type,x_m,y_m\n0.0,7,pedestrian,1.0,2.0\n0.4,7,pedestrian,1.5,2.0\n";
//! let input = Input::new(Role::Rows, "walk.csv", text);
//! assert_eq!(Format::detect(&input)?, Format::Csv);
//!
//! let recording = parse(Format::Csv, &[input])?;
//! assert_eq!((recording.frames.len(), recording.interval_ns), (2, 400_000_000));
//! let tracks = data::tracks(&recording);
//! let (stamp_ns, newest) = tracks[0].states[1];
//! assert_eq!((stamp_ns, newest.position_m), (400_000_000, [1.5, 2.0]));
//! assert!((newest.velocity_mps[0] - 1.25).abs() < 1e-6); // m/s, a backward difference
//!
//! let text = "stamp_s,type,x_m,y_m\n0,car,1,2\n";
//! let broken = Input::new(Role::Rows, "b.csv", text);
//! let error = parse(Format::Csv, &[broken]).unwrap_err().to_string();
//! assert!(error.starts_with("b.csv:2:3: type = \"car\": expected vehicle"), "{error}");
//! # Ok::<(), data::ReadError>(())
//! ```

mod damage;
mod egos;
mod error;
mod folder;
mod format;
pub mod formats;
mod frame_rate;
mod generated;
mod input;
mod inspection;
mod interval;
mod lines;
mod open;
mod order;
mod recording;
mod recording_file;
mod row;
mod rows;
pub mod sets;
mod stamp;
mod sweeps;
mod text;
mod track_file;
mod tracks;
mod windows;

pub use error::{ErrorPlace, ReadError};
pub use folder::recordings_in;
pub use format::{Format, UnknownFormat};
pub use formats::rosbag::{PredictedAgent, PredictedFrame, PredictedPath, predicted_objects};
pub use frame_rate::{FrameRate, UnknownFrameRate};
pub use generated::{GeneratedScene, OptionError, SceneOptions};
pub use input::{FILE_BYTES_MAX, Input, Role};
pub use inspection::{Gap, Inspection, TypeInspection, findings, inspect};
pub use lines::Lines;
pub use open::{OpenOptions, STANDARD_INPUT, identity, is_standard_input, open, open_with, parse, parse_at};
pub use recording::{BagTopic, Ego, Frame, LeftOut, Recording};
pub use recording_file::write_frames;
pub use track_file::{TrackFormat, TrackRows, TrackWriter, UnknownTrackFormat};
pub use tracks::{RecordedTrack, Reported, tracks, tracks_from_positions};
pub use windows::{Window, WindowAgent, WindowOptions, windows};
