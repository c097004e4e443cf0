//! The context map of a site, from recordings or from its lanes (`stgdat map`).
//!
//! **In:** recordings in one world frame. **Out:** a [`SiteMap`]: density and mean velocity (m/s) per cell of
//! 1 m × 1 m, as arrays [row = y, column = x] \[model §2\].
//!
//! A *visit* is an agent's position at a time. A trajectory has at most one visit per tick of the pipeline,
//! whatever the rate of its recording. So maps from recordings and maps gathered online weigh the same ground
//! equally. If the recording has velocities, visits use them. If not, velocities are backward differences.
//! Detections with neither identity nor velocity are left out and counted.
//!
//! A map contains whole recordings. Build it from the training part, never from a recording that is to be
//! forecast.

mod from_lanes;

pub use from_lanes::of_lanes;

use data::{RecordedTrack, Recording};
use scene::{CELLS_MAX, ContextMap, MapBuilder};
use thiserror::Error;
use wire::detection_flags::{HAS_HEADING, HAS_ID, HAS_SPEED};

/// Minimum time between visits of one trajectory: a tick of the pipeline.
const VISIT_INTERVAL_NS: i64 = wire::TICK_NS.cast_signed();

/// A map and statistics of its recordings.
#[derive(Clone, Debug)]
pub struct SiteMap {
    /// The map; it covers the visited ground.
    pub map: ContextMap,
    /// Number of visits.
    pub visit_count: usize,
    /// Detections that are left out because their velocity is unknown.
    pub left_out_len: usize,
}

/// Why no map can be built.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum MapError {
    /// No detection has a velocity.
    #[error("no visits: the recordings hold no trajectories and no detections with heading and speed")]
    NoVisits,
    /// No lane is for vehicles or cyclists.
    #[error("the map has no lane that vehicles or cyclists use")]
    NoRoads,
    /// The map would be too large.
    #[error(
        "the visits span {rows} × {cols} cells of 1 m, at most {CELLS_MAX} cells allowed: map one site at a time"
    )]
    TooLarge {
        /// Cells along y.
        rows: usize,
        /// Cells along x.
        cols: usize,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Visit {
    position_m: [f32; 2],
    velocity_mps: [f32; 2],
}

/// The map of all visits in recordings that share one world frame.
///
/// # Errors
/// [`MapError`] if there are no visits, or if they span more than a map can hold.
pub fn build(recordings: &[Recording]) -> Result<SiteMap, MapError> {
    let mut visits = Vec::new();
    let mut left_out_len = 0;
    for recording in recordings {
        for track in data::tracks(recording) {
            left_out_len += visit_track(&track, &mut visits);
        }
        left_out_len += visit_loose_detections(recording, &mut visits);
    }
    let (origin_m, [cols, rows]) =
        scene::extent(visits.iter().map(|visit| visit.position_m)).ok_or(MapError::NoVisits)?;
    let mut builder = MapBuilder::new(origin_m, rows, cols).ok_or(MapError::TooLarge { rows, cols })?;
    let visit_count =
        visits.iter().filter(|visit| builder.visit(visit.position_m, visit.velocity_mps)).count();
    Ok(SiteMap { map: builder.build(), visit_count, left_out_len })
}

/// Appends a trajectory's visits. Returns the number of states without velocity.
fn visit_track(track: &RecordedTrack, visits: &mut Vec<Visit>) -> usize {
    if track.starts_unmoved && track.states.len() == 1 {
        return 1;
    }
    let mut last_ns = None;
    for (stamp_ns, _) in &track.states {
        if last_ns.is_some_and(|last_ns| stamp_ns - last_ns < VISIT_INTERVAL_NS) {
            continue;
        }
        // All states are known here, so the first one has the velocity of the second.
        if let Some(state) = track.state_at(*stamp_ns, i64::MAX, 0) {
            visits.push(Visit { position_m: state.position_m, velocity_mps: state.velocity_mps });
            last_ns = Some(*stamp_ns);
        }
    }
    0
}

/// Appends the visits of detections without identity. Returns the number of those without velocity.
fn visit_loose_detections(recording: &Recording, visits: &mut Vec<Visit>) -> usize {
    let mut left_out_len = 0;
    for detection in recording.frames.iter().flat_map(|frame| &frame.detections) {
        if detection.has(HAS_ID) {
            continue;
        }
        if !detection.has(HAS_HEADING | HAS_SPEED) {
            left_out_len += 1;
            continue;
        }
        let (sin, cos) = detection.heading_rad.sin_cos();
        visits.push(Visit {
            position_m: [detection.x_m, detection.y_m],
            velocity_mps: [cos * detection.speed_mps, sin * detection.speed_mps],
        });
    }
    left_out_len
}
