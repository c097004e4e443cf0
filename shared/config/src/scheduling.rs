//! On which processors a stage runs and with what priority, as a pipeline.toml sets it.

/// What the kernel's scheduler is told of one stage; nothing by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scheduling {
    /// Numbers of the processors that all its threads keep to, in increasing order; all where empty.
    pub cpus: Vec<u32>,
    /// Its priority in the real-time class SCHED_FIFO; the normal class where none.
    pub priority: Option<u8>,
}

impl Scheduling {
    /// Greatest number of a processor: the kernel's sets of processors hold 1024.
    pub const CPU_MAX: u32 = 1023;
    /// Least and greatest priority of SCHED_FIFO on Linux.
    pub const PRIORITIES: [u8; 2] = [1, 99];

    /// Whether nothing is set.
    #[must_use]
    pub const fn is_default(&self) -> bool {
        self.cpus.is_empty() && self.priority.is_none()
    }
}
