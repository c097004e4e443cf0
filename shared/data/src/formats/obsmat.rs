//! The ETH scene in its true time base: `frame id x z y vx vz vy`, 6 frames in 0.4 s, metres.
//!
//! The velocities are checked but not used: they are central differences of the positions, so they leak the
//! next row.

use wire::AgentType;

use crate::input::need;
use crate::rows::{self, Rows};
use crate::text::{self, Separator};
use crate::{FrameRate, Input, ReadError, Recording, Role, sweeps};

/// Rate of the frame numbers, and frames per step.
pub(crate) const RATE: FrameRate = FrameRate::of_centihertz(1_500);
const STEP: u32 = 6;
const NAMES: [&str; 8] = ["frame", "id", "x", "z", "y", "vx", "vz", "vy"];

/// Reads such a file.
pub(crate) fn parse(inputs: &[Input], rate: FrameRate) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let mut rows = Rows::default();
    rows.read(text::lines(input), Separator::Space, &NAMES, |[frame, id, x, z, y, vx, vz, vy]| {
        for unused in [z, vx, vz, vy] {
            unused.number()?;
        }
        let detection =
            rows::identified(AgentType::Pedestrian, text::position_m([x, y])?, id.id_below(u64::MAX)?);
        Ok((frame.stamp_ns(rate)?, detection))
    })?;
    sweeps::identified(rows, input, AgentType::Pedestrian.bit(), rate, STEP)
}
