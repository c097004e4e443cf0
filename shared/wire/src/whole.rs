//! All entries of the table.

use crate::table::{Flags, Table};
use crate::topic::TOPICS;
use crate::{
    AgentControls, AgentEncoding, AgentFeatures, AgentType, Cause, ControlGaussian, Counts, Detection, Edge,
    Expert, Forecast, ForeseenConflict, Header, Heartbeat, HistoryState, Hop, InputCounts, LinkCount,
    Protection, Quality, RefusalCause, Refusals, Row, SCHEMA, StageId, StampSource, Steering, Track,
    TrackStatus, Truth, detection_flags, doubts, flags, limits,
};

/// The whole wire.
pub const TABLE: Table = Table {
    schema: SCHEMA,
    constants: limits::CONSTANTS,
    flags: &[
        Flags { name: "flags", doc: "Bits of `Header.flags`.", bits: flags::CONSTANTS },
        Flags {
            name: "detection_flags",
            doc: "Bits of `Detection.flags`.",
            bits: detection_flags::CONSTANTS,
        },
        Flags { name: "doubts", doc: "Bits of `InputCounts.doubts`.", bits: doubts::CONSTANTS },
    ],
    numbers: &[
        StageId::NUMBERS,
        StampSource::NUMBERS,
        AgentType::NUMBERS,
        TrackStatus::NUMBERS,
        Quality::NUMBERS,
        Cause::NUMBERS,
        Steering::NUMBERS,
        Expert::NUMBERS,
        RefusalCause::NUMBERS,
        LinkCount::NUMBERS,
    ],
    records: &[
        Protection::RECORD,
        Hop::RECORD,
        Counts::RECORD,
        InputCounts::RECORD,
        Header::RECORD,
        Detection::RECORD,
        Truth::RECORD,
        HistoryState::RECORD,
        Track::RECORD,
        Row::RECORD,
        AgentFeatures::RECORD,
        Edge::RECORD,
        AgentEncoding::RECORD,
        ControlGaussian::RECORD,
        AgentControls::RECORD,
        ForeseenConflict::RECORD,
        Forecast::RECORD,
        Refusals::RECORD,
        Heartbeat::RECORD,
    ],
    topics: &TOPICS,
};
