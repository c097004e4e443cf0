//! The data that the stages exchange: topics, message headers and payload elements.
//!
//! A *topic* names a stream, fixes the element type of its messages and bounds every queue. A *frame* is one
//! message: a [`Header`] and a slice of elements. All frames of one tick have the same `seq` and `stamp_ns`.
//! Each stage appends a [`Hop`], so that the last frame of a tick contains the tick's whole path.
//!
//! Payloads are plain old data (`#[repr(C)]`, explicit padding, any bit pattern is a value, little-endian).
//! They cross process borders unchanged. Every record is declared once, with the offset of each field. The
//! declaration produces the struct, the assertions of its layout and its entry in [`TABLE`]. `stgdat wire`
//! prints the table for C, C++, Python and others.
//!
//! Frames of reference: positions are in one right-handed, metric *world frame* (x, y; z up) with an origin
//! within [`POSITION_MAX_M`]. Headings are counter-clockwise from +x in radians. Times are nanoseconds:
//! `stamp_ns` on the sensor's or recording's clock, all others on `CLOCK_MONOTONIC`.
//!
//! A frame from its bytes, from any source:
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
//! [`SCHEMA`] is the single version of the whole wire: of the header, of all payloads and of all topics. It
//! is part of every type name (`stgdat.header.2`, `stgdat.forecasts.2`) and of every header. Programs with
//! the same number are compatible, whatever their age.
//!
//! These changes need no new version:
//!
//! * *Reserved bytes* get a name and a meaning in which 0 stands for "not reported" or for the previous
//!   behaviour. Writers fill unknown bytes with zeros; in headers they copy the bytes of the received tick.
//!   Readers ignore unknown bytes. [`Detection::sensor`], [`Header::protection`], [`Header::shed`],
//!   [`Heartbeat::refusals`], [`Track::learned_age_ns`], [`Forecast::expert_weights`] and
//!   [`Forecast::out_of_distribution`] were added in this way; older writers leave them 0.
//! * *New numbers* of [`StageId`], [`StampSource`], [`TrackStatus`], [`Cause`] and [`Expert`]. Readers treat
//!   a number that they do not know as unknown, and do not refuse frames for it.
//! * *New flags*, if a reader may ignore them: their absence means the previous behaviour.
//! * *New topics* and new constants.
//!
//! All other changes need a new version: a field that moves or changes its size, type, unit or meaning;
//! another limit; a new number of [`AgentType`], [`Quality`] or [`Steering`]. Readers compute with these
//! three and refuse unknown numbers.
//!
//! If programs of two versions meet:
//!
//! * *Ports do not connect.* If a program of another version has created a topic, opening it fails with the
//!   transport's `IncompatibleTypes`. In `ports` this is a `PortError`, `frames of topic "tracks":
//!   …(IncompatibleTypes)`, which ends the process (exit code 69). In Python it is a
//!   `PublishSubscribeOpenError`. No byte is exchanged.
//! * *A header of another schema* under the right type name, from a writer with a wrong [`Header::schema`],
//!   is refused with [`Rejected::Schema`]. The frame is dropped, reported on standard error and counted in
//!   the `rejected_len` of the reader's [`Heartbeat`]. The reader continues.

mod agent;
mod check;
mod declare;
mod header;
mod layout;
mod limits;
mod named;
mod origin;
mod protection;
mod records;
mod stage;
mod table;
#[cfg(test)]
mod tests;
mod tick;
pub mod tick_view;
mod topic;
pub mod vocabulary;
mod whole;

pub use agent::{AGENT_TYPES, AgentType, UnknownAgentType};
pub use check::{Rejected, at_most, equal, finite};
pub use header::{Counts, Header, Hop, InputCounts, Protection, StampSource, doubts, flags};
pub use layout::{
    Context, ContextMut, ContextShape, Edge, FeatureShape, Features, FeaturesMut, Row, context_rows,
    feature_rows,
};
pub use limits::{
    ADDED_STAGES_MAX, ADDED_TOPICS_MAX, AGENTS_MAX, CONFLICTS_MAX, CONTEXT_EMBEDDING, DETECTIONS_MAX,
    EDGE_ATTRIBUTES, EDGES_MAX, ELEMENT_SIZE_MAX, EXPERTS_MAX, HISTORY_MAX, HOPS_MAX, HORIZON_MAX,
    INTERVAL_MAX_NS, INTERVAL_MIN_NS, LATENT, MODES_MAX, NODE_ATTRIBUTES, OFFSET_MAX_NS, PATCH_CHANNELS,
    PATCH_SIDE_MAX, POSITION_MAX_M, REFUSALS_MAX, RELATION_FEATURES, SCHEMA, SENSORS_MAX, SEQ_MAX,
    SHED_WORDS, SPEED_MAX_MPS, STATE_EMBEDDING, STATE_FEATURES, TEMPORAL,
};
pub use origin::{UnknownWorldOrigin, WorldOrigin};
pub use protection::{crc64, data_id};
pub use records::{
    AgentControls, AgentEncoding, AgentFeatures, Cause, ControlGaussian, Detection, Expert, Forecast,
    ForeseenConflict, Heartbeat, HistoryState, LinkCount, Quality, RefusalCause, Refusals, Steering, Track,
    TrackStatus, Truth, detection_flags,
};
pub use stage::StageId;
pub use table::{
    Constant, Field, Flags, Layout, Leaf, Number, Numbers, Primitive, Record, Table, TopicEntry, Type, Value,
};
pub use tick::{TICK_MS, TICK_NS};
pub use topic::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic,
    HeartbeatsTopic, Topic, TracksTopic, TruthTopic,
};
pub use whole::TABLE;
