//! Numbers that all processes of a run share.

use std::time::Duration;

use wire::TICK_NS;

/// Time between the heartbeats of a stage: one tick, with or without work.
pub const HEARTBEAT: Duration = Duration::from_nanos(TICK_NS);
/// Processes of a run that may use a topic: all stages, the launcher, and spares for tools.
pub(crate) const NODES_MAX: usize = 20;

/// Maximum numbers of ports of a topic, and its maximum queue depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub publishers_max: usize,
    pub subscribers_max: usize,
    pub nodes_max: usize,
    pub depth_max: usize,
}
