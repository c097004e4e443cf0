//! The lanes of a site.

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use wire::AGENT_TYPES;

use crate::error;
use crate::recording::{Recording, parse};

/// Identity, numbers of the agent types, speed limit (m/s); centre line, half widths, left and right bound as 32-bit
/// floats (m); successors; left and right neighbour.
type Lane<'py> = (i64, Vec<u32>, Option<f32>, [Bound<'py, PyBytes>; 4], Vec<u32>, [Option<u32>; 2]);

/// The lanes of the map that arguments of `stgdat predict` name, in the world frame of a recording.
#[pyfunction]
pub fn lanes<'py>(
    py: Python<'py>,
    recording: &Bound<'py, Recording>,
    arguments: Vec<String>,
) -> PyResult<Vec<Lane<'py>>> {
    let origin = recording.get().origin;
    let map = py.detach(|| {
        parse(arguments)?.model().open_lanes(origin).map_err(|failure| error::of_failure(&failure))
    })?;
    let lane = |lane: &_| of_lane(py, lane);
    Ok(map.iter().flat_map(::lanes::LaneMap::lanes).map(lane).collect())
}

fn of_lane<'py>(py: Python<'py>, lane: &::lanes::Lane) -> Lane<'py> {
    let users = AGENT_TYPES.into_iter().filter(|&of| lane.users.contain(of)).map(|of| of as u32);
    let bytes = |values: &[f32]| PyBytes::new(py, bytemuck::cast_slice(values));
    let [left, right] = &lane.bounds_m;
    let lines = [
        bytes(lane.centre_m.as_flattened()),
        bytes(&lane.half_width_m),
        bytes(left.as_flattened()),
        bytes(right.as_flattened()),
    ];
    (lane.id, users.collect(), lane.limit_mps, lines, lane.successors.clone(), lane.neighbours)
}
