//! What the stages exchange: topics, message headers and payload elements.
//!
//! A *topic* names a stream, fixes the element type of its messages and bounds every queue. A *frame* is one
//! message: a [`Header`] and a slice of elements. All frames of one tick carry the same `seq` and `stamp_ns`,
//! and each stage appends a [`Hop`], so that the last frame of a tick contains the way of the whole tick.
//!
//! Payloads are plain old data (`#[repr(C)]`, explicit padding, any bit pattern is a value, little-endian):
//! they cross process borders as they lie in memory. Every record is declared once, with the offset of each
//! field; from that come the struct, the assertions of its layout and its entry of [`TABLE`], which
//! `stgdat wire` prints for C, C++, Python and everybody else.
//!
//! Frames of reference: positions are in one right-handed, metric *world frame* (x, y; z up) whose origin
//! lies within [`POSITION_MAX_M`]; headings are counter-clockwise from +x in radians. Times are nanoseconds:
//! `stamp_ns` on the sensor's or recording's clock, all others on `CLOCK_MONOTONIC`.
//!
//! A frame from its bytes, wherever they come from:
//!
//! ```
//! use wire::{Header, Rejected, SCHEMA, Topic, Track, TracksTopic};
//!
//! fn tracks(header: &[u8], payload: &[u8]) -> Result<Vec<Track>, Rejected> {
//!     let header: Header = bytemuck::pod_read_unaligned(header);
//!     header.check()?;
//!     let elements = payload.chunks_exact(size_of::<Track>());
//!     let tracks: Vec<Track> = elements.map(bytemuck::pod_read_unaligned).collect();
//!     let (found, expected) = (tracks.len(), TracksTopic::elements_len(&header.counts));
//!     if found != expected {
//!         return Err(Rejected::Length { found, expected });
//!     }
//!     tracks.iter().try_for_each(Track::check)?;
//!     Ok(tracks)
//! }
//!
//! let mut header = Header::new(7, 0, 80_000_000);
//! header.counts.agents_len = 1;
//! let track = Track { id: 4, x_m: 1.5, ..bytemuck::Zeroable::zeroed() };
//! let payload = bytemuck::bytes_of(&track);
//! assert_eq!(tracks(bytemuck::bytes_of(&header), payload), Ok(vec![track]));
//!
//! let other_version = Header { schema: 1, ..header };
//! let refused = tracks(bytemuck::bytes_of(&other_version), payload);
//! assert_eq!(refused, Err(Rejected::Schema { found: 1, expected: SCHEMA }));
//! let nowhere = Track { x_m: f32::NAN, ..track };
//! let refused = tracks(bytemuck::bytes_of(&header), bytemuck::bytes_of(&nowhere));
//! assert!(matches!(refused, Err(Rejected::NotFinite { .. })));
//! ```
//!
//! # Versions
//!
//! [`SCHEMA`] is the one version of the whole wire: of the header, of all payloads and of all topics. Every
//! type name carries it (`stgdat.header.2`, `stgdat.forecasts.2`), and so does every header. Programs of one
//! number understand each other, however old they are.
//!
//! These changes need no new version:
//!
//! * *Reserved bytes* get a name and a meaning in which 0 stands for "not reported" or for what was so
//!   before. Writers fill bytes that they do not know with zeros, those of the header as they came in with
//!   the tick; readers do not look at them. So it is with [`Header::protection`], [`Header::shed`],
//!   [`Heartbeat::refusals`], [`Track::learned_age_ns`], [`Forecast::expert_weights`] and
//!   [`Forecast::out_of_distribution`] of a writer that does not know them.
//! * *New numbers* of [`StageId`], [`StampSource`], [`TrackStatus`], [`Cause`] and [`Expert`]. Readers take a
//!   number that they do not know for an unknown one and refuse nothing for it.
//! * *New flags*, if a reader may overlook them: their absence means what was so before.
//! * *New topics* and new constants.
//!
//! All else does: a field that moves or changes its size, type, unit or meaning; another limit; a new number
//! of [`AgentType`], [`Quality`] or [`Steering`], which readers compute with and refuse where they do not
//! know it.
//!
//! Programs of two versions meet like this:
//!
//! * *Ports do not connect.* A program that opens a topic after one of another version has made it gets
//!   the transport's `IncompatibleTypes`: with `ports` a `PortError`,
//!   `frames of topic "tracks": …(IncompatibleTypes)`, with which the process ends (exit code 69); in Python
//!   a `PublishSubscribeOpenError`. No byte is exchanged.
//! * *A header of another schema* under the right type name, from a writer that fills in a wrong
//!   [`Header::schema`], is refused with [`Rejected::Schema`]. The frame is dropped, reported on standard
//!   error and counted in the `rejected_len` of the reader's [`Heartbeat`]; the reader goes on.

mod agent;
mod check;
mod declare;
#[cfg(test)]
mod distinct;
mod header;
mod layout;
mod limits;
mod origin;
mod protection;
mod records;
mod stage;
mod table;
mod tick;
mod topic;

pub use agent::{AGENT_TYPES, AgentType, UnknownAgentType};
pub use check::{Rejected, finite};
pub use header::{Counts, Header, Hop, InputCounts, StampSource, doubts, flags};
pub use layout::{
    Context, ContextMut, ContextShape, Edge, FeatureShape, Features, FeaturesMut, Row, context_rows,
    feature_rows,
};
pub use limits::{
    ADDED_STAGES_MAX, ADDED_TOPICS_MAX, AGENTS_MAX, CONTEXT_EMBEDDING, DETECTIONS_MAX, EDGE_ATTRIBUTES,
    EDGES_MAX, ELEMENT_SIZE_MAX, EXPERTS_MAX, HISTORY_MAX, HOPS_MAX, HORIZON_MAX, LATENT, MODES_MAX,
    NODE_ATTRIBUTES, OFFSET_MAX_NS, PATCH_CHANNELS, PATCH_SIDE_MAX, POSITION_MAX_M, REFUSALS_MAX,
    RELATION_FEATURES, SCHEMA, SHED_WORDS, SPEED_MAX_MPS, STATE_EMBEDDING, STATE_FEATURES, TEMPORAL,
};
pub use origin::{UnknownWorldOrigin, WorldOrigin};
pub use protection::{Protection, RefusalCause, Refusals, data_id};
pub use records::{
    AgentControls, AgentEncoding, AgentFeatures, Cause, ControlGaussian, Detection, Expert, Forecast,
    Heartbeat, HistoryState, Quality, Steering, Track, TrackStatus, Truth, detection_flags,
};
pub use stage::StageId;
pub use table::{
    Constant, Field, Flags, Layout, Leaf, Number, Numbers, Primitive, Record, TABLE, Table, TopicEntry, Type,
    Value,
};
pub use tick::{TICK_MS, TICK_NS};
pub use topic::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic,
    HeartbeatsTopic, Topic, TracksTopic, TruthTopic,
};
