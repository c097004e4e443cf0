//! The processors and the priority of a stage, as set by pipeline.toml.

/// The settings of one stage for the kernel's scheduler. The default sets nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scheduling {
    /// Numbers of the processors for all its threads, in increasing order. Empty means all processors.
    pub cpus: Vec<u32>,
    /// The priority in the real-time class SCHED_FIFO; `None` for the normal class.
    pub priority: Option<u8>,
}

impl Scheduling {
    /// Largest number of a processor. The kernel's processor sets have 1024 entries.
    pub const CPU_MAX: u32 = 1023;
    /// Smallest and largest priority of SCHED_FIFO on Linux.
    pub const PRIORITIES: [u8; 2] = [1, 99];

    /// Whether nothing is set.
    #[must_use]
    pub const fn is_default(&self) -> bool {
        self.cpus.is_empty() && self.priority.is_none()
    }
}
