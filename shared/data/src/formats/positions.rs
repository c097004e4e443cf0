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
use crate::{FrameRate, Input, ReadError, Recording, Role, sweeps};

const NAMES: [&str; 4] = ["frame", "id", "x", "y"];
/// Rate of ETH/UCY's frame numbers, and frames per step.
pub(crate) const ETH_UCY_RATE: FrameRate = FrameRate::of_centihertz(2_500);
const ETH_UCY_STEP: u32 = 10;
/// Rate of the TrajNet split's frame numbers, and frames per step.
pub(crate) const TRAJNET_RATE: FrameRate = FrameRate::of_centihertz(3_000);
const TRAJNET_STEP: u32 = 12;

/// Reads ETH/UCY.
pub(crate) fn parse_eth_ucy(inputs: &[Input], rate: FrameRate) -> Result<Recording, ReadError> {
    parse(need(inputs, Role::Rows)?, rate, ETH_UCY_STEP)
}

/// Reads the TrajNet split of Stanford Drone. The scene's scale comes from the table beside the file, if it
/// exists.
pub(crate) fn parse_trajnet(inputs: &[Input], rate: FrameRate) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let mut recording = parse(input, rate, TRAJNET_STEP)?;
    if let Some(table) = crate::input::find(inputs, Role::Scales) {
        recording.pixel_m = super::sdd_raw::table_pixel_m(table, &crate::input::stem(&input.path))?;
    }
    Ok(recording)
}

fn parse(input: &Input, rate: FrameRate, frames_per_step: u32) -> Result<Recording, ReadError> {
    let mut rows = Rows::default();
    rows.read(text::lines(input), Separator::Space, &NAMES, |[frame, id, x, y]| {
        let detection =
            rows::identified(AgentType::Pedestrian, text::position_m([x, y])?, id.id_below(u64::MAX)?);
        Ok((frame.stamp_ns(rate)?, detection))
    })?;
    sweeps::identified(rows, input, AgentType::Pedestrian.bit(), rate, frames_per_step)
}
