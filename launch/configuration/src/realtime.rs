//! Real-time settings of pipeline.toml.

use wire::StageId;

/// The settings of a whole run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Realtime {
    /// Whether processors are kept from sleeping between ticks.
    pub awake: bool,
    /// Whether the launcher raises the limit of locked memory as far as the system permits.
    pub lock: bool,
    /// Stages that get the processors that the machine has set aside.
    pub auto_cpu: Vec<StageId>,
}
