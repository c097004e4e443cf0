//! What the supervisor does when a stage ends, as a pipeline.toml sets it.

use std::time::Duration;

use serde::Deserialize;

/// When a stage that has ended is started again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Never: the stage is given up.
    Never,
    /// When it was killed or ended with an exit code other than 0; not after exit code 78, which says that
    /// its configuration can't be used.
    #[default]
    OnFailure,
    /// However it ended, but for exit code 78.
    Always,
}

/// The restart policy of one stage: a table `restart_policy` of pipeline.toml.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RestartPolicy {
    /// When it is started again.
    pub restart: Restart,
    /// Pause before the second restart within the window; doubles with each further one.
    pub backoff: Duration,
    /// Most restarts within the window; then the stage is given up for good.
    pub restarts_max: u32,
    /// The window.
    pub window: Duration,
    /// Longest time from a restart until the stage is linked.
    pub start_limit: Duration,
    /// CPU time that a stage may use, and time that it may sleep, without a heartbeat.
    pub hang_after: Duration,
}

impl RestartPolicy {
    /// Longest pause before a restart: within the 4.8 s of a forecast's horizon, which bridges it.
    pub const BACKOFF_MAX: Duration = Duration::from_secs(4);
}

impl Default for RestartPolicy {
    fn default() -> Self {
        Self {
            restart: Restart::OnFailure,
            // A tick. The first restart has no pause at all: most deaths are single ones.
            backoff: Duration::from_millis(80),
            // With the pauses before them (0, 80, 160, 320, 640 ms) five starts take two to three seconds: a
            // fault that is still there then is not one that passes.
            restarts_max: 5,
            // A stage that dies less than five times a minute has its output most of the time.
            window: Duration::from_mins(1),
            // Weights are loaded in under 0.5 s; twenty times that for a machine under load.
            start_limit: Duration::from_secs(10),
            // A dozen ticks, and ten times the longest step measured with 128 agents.
            hang_after: Duration::from_secs(1),
        }
    }
}
