//! Real-time settings of pipeline.toml.

use wire::StageId;

/// The settings of one stage for the kernel. The default sets nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scheduling {
    /// Numbers of the processors for all its threads, in increasing order. Empty means all processors.
    pub cpus: Vec<u32>,
    /// The priority in the real-time class SCHED_FIFO; `None` for the normal class.
    pub priority: Option<u8>,
    /// Whether its memory is not locked. By default a stage locks as much as its limit permits.
    pub unlocked: bool,
}

impl Scheduling {
    /// Largest number of a processor. The kernel's processor sets have 1024 entries.
    pub const CPU_MAX: u32 = 1023;
    /// Largest priority of SCHED_FIFO on Linux. 0 is the normal class.
    pub const PRIORITY_MAX: u8 = 99;

    /// Whether nothing is set.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The processors as text, such as `2+3`; `None` if none are set.
    #[must_use]
    pub fn cpu_list(&self) -> Option<String> {
        let cpus: Vec<String> = self.cpus.iter().map(u32::to_string).collect();
        (!cpus.is_empty()).then(|| cpus.join("+"))
    }
}

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
