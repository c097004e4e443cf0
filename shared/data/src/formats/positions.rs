//! Annotated pedestrians as `frame id x y`, in metres: the ETH/UCY folds and the TrajNet split of Stanford
//! Drone.
//!
//! | | frames | separator | axes |
//! |---|---|---|---|
//! | ETH/UCY | every 10th, 0.4 s | tab | world |
//! | SDD TrajNet | every 12th, 0.4 s | space | the image's: y points down, so the scene is mirrored |
//!
//! Coordinates are passed on unchanged. All agents are pedestrians: the files contain no classes. A frame
//! without rows is not part of the recording.

use wire::AgentType;

use crate::input::need;
use crate::rows::{self, Rows};
use crate::text::{self, Separator};
use crate::{Input, ReadError, Recording, Role};

const NAMES: [&str; 4] = ["frame", "id", "x", "y"];
/// Time between annotated frames.
pub(crate) const STEP_NS: u64 = 400_000_000;

/// Reads ETH/UCY.
///
/// # Errors
/// [`ReadError`] with file, line, column and value.
pub(crate) fn parse_eth_ucy(inputs: &[Input]) -> Result<Recording, ReadError> {
    parse(need(inputs, Role::Rows)?, 10)
}

/// Reads the TrajNet split of Stanford Drone; the scene's scale is taken from the table beside it, if there
/// is one.
///
/// # Errors
/// [`ReadError`] with file, line, column and value.
pub(crate) fn parse_trajnet(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let mut recording = parse(input, 12)?;
    if let Some(table) = crate::input::find(inputs, Role::Scales) {
        recording.pixel_m = super::sdd_raw::table_pixel_m(table, &crate::open::stem(&input.path))?;
    }
    Ok(recording)
}

fn parse(input: &Input, frames_per_step: i64) -> Result<Recording, ReadError> {
    let mut rows = Rows::default();
    for line in text::lines(input) {
        let line = line?;
        let [frame, id, x, y] = line.split(Separator::Space, &NAMES)?;
        let detection = rows::identified(
            AgentType::Pedestrian,
            [x.position_m()?, y.position_m()?],
            id.id_below(u64::MAX)?,
        );
        rows.push(&line, stamp_ns(frame.frame()?, frames_per_step), detection)?;
    }
    let frames = rows::frames(&rows.sorted(input)?, AgentType::Pedestrian.bit());
    Ok(Recording { interval_ns: STEP_NS, has_identities: true, frames, ..Recording::default() })
}

/// The time of a frame where `frames_per_step` frames last 0.4 s; exact at whole steps, else rounded.
pub(crate) fn stamp_ns(frame: i64, frames_per_step: i64) -> i64 {
    (frame * STEP_NS as i64 + frames_per_step / 2) / frames_per_step
}
