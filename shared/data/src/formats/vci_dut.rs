//! VCI-DUT and VCI-CITR: vehicles and dense crowds on a campus, as a pair of files, metres. The files do not
//! contain their frame rate: DUT has 23.98 frames a second, CITR 29.97.
//!
//! The columns are `id,frame,label,x_est,y_est,psi_est,vel_est` for vehicles and `…,vx_est,vy_est` for
//! pedestrians. Both files count frames on one clock and identities from 0. The reader adds 1,000,000,000 to
//! the identities of pedestrians. The positions are the output of the data set's own causal filter. A
//! pedestrian slower than 0.1 m/s has no heading.

use wire::{AgentType, Detection, detection_flags};

use crate::input::{find, need_any};
use crate::rows::{self, PEDESTRIAN_IDS, Rows};
use crate::text::{self, Field, Line, Separator};
use crate::{FrameRate, Input, ReadError, Recording, Role, sweeps};

const VEHICLE_NAMES: [&str; 7] = ["id", "frame", "label", "x_est", "y_est", "psi_est", "vel_est"];
const PEDESTRIAN_NAMES: [&str; 7] = ["id", "frame", "label", "x_est", "y_est", "vx_est", "vy_est"];
/// The frame rate of DUT.
pub(crate) const RATE: FrameRate = FrameRate::of_centihertz(2_398);

/// Reads a pair, or one file of it.
pub(crate) fn parse(inputs: &[Input], rate: FrameRate) -> Result<Recording, ReadError> {
    let first = need_any(inputs, &[Role::Vehicles, Role::Pedestrians])?;
    let mut rows = Rows::default();
    let mut observed_types = 0;
    let kinds = [
        (Role::Vehicles, AgentType::Vehicle, VEHICLE_NAMES),
        (Role::Pedestrians, AgentType::Pedestrian, PEDESTRIAN_NAMES),
    ];
    for (role, agent_type, names) in &kinds {
        if let Some(input) = find(inputs, *role) {
            observed_types |= agent_type.bit();
            let lines = text::lines_below(input, names);
            rows.read(lines, Separator::Comma, names, |fields| row(fields, *agent_type, rate))?;
        }
    }
    sweeps::identified(rows, first, observed_types, rate, 1)
}

fn row(
    [id, frame, label, x, y, a, b]: [Field<'_>; 7],
    agent_type: AgentType,
    rate: FrameRate,
) -> Result<(i64, Detection), ReadError> {
    let expected = if agent_type == AgentType::Vehicle { "veh" } else { "ped" };
    if label.text != expected {
        return Err(label.error(format!("expected {expected}")));
    }
    let detection = rows::identified(agent_type, text::position_m([x, y])?, id.id_below(PEDESTRIAN_IDS)?);
    let detection = match agent_type {
        AgentType::Vehicle => Detection {
            heading_rad: a.angle_rad()?,
            speed_mps: b.speed_mps()?,
            flags: detection.flags | detection_flags::HAS_HEADING | detection_flags::HAS_SPEED,
            ..detection
        },
        _ => rows::with_velocity(Detection { id: detection.id + PEDESTRIAN_IDS, ..detection }, a, b)?,
    };
    Ok((frame.stamp_ns(rate)?, detection))
}

/// The role of a file, by its first line.
pub(crate) fn role_of(first: &Line<'_>) -> Option<Role> {
    let is = |names: &[&str]| first.is_header_of(names);
    let pedestrians = || is(&PEDESTRIAN_NAMES).then_some(Role::Pedestrians);
    is(&VEHICLE_NAMES).then_some(Role::Vehicles).or_else(pedestrians)
}
