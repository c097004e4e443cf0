//! The supervisor's action when a stage ends, as set by pipeline.toml.

use std::time::Duration;

use serde::Deserialize;

/// The rule for restarting a stage that has ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Restart {
    /// Never: the supervisor gives up on the stage.
    Never,
    /// If it was killed or ended with an exit code other than 0. Exit code 78 is excluded, because it means
    /// that the configuration cannot be used.
    #[default]
    OnFailure,
    /// After any end except exit code 78.
    Always,
}

/// The restart policy of one stage, from keys of its table in pipeline.toml.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RestartPolicy {
    /// When the stage is started again.
    pub restart: Restart,
    /// Pause before the second restart within the window. It doubles with each further restart.
    pub backoff: Duration,
    /// Largest number of restarts within the window. After these the supervisor gives up on the stage.
    pub restarts_max: u32,
    /// The window.
    pub window: Duration,
    /// Longest time from a restart until the stage is linked.
    pub start_limit: Duration,
    /// CPU time that a stage may use without a heartbeat, and time that it may sleep without one.
    pub hang_after: Duration,
}

impl RestartPolicy {
    /// Longest pause before a restart. The 4.8 s horizon of a forecast bridges it.
    pub const BACKOFF_MAX: Duration = Duration::from_secs(4);
}

impl Default for RestartPolicy {
    fn default() -> Self {
        Self {
            restart: Restart::OnFailure,
            // One tick. The first restart has no pause, because most deaths are single ones.
            backoff: Duration::from_millis(80),
            // With the pauses before them (0, 80, 160, 320, 640 ms) five starts take two to three seconds. A
            // fault that persists this long is not transient.
            restarts_max: 5,
            // A stage that dies less than five times a minute has output most of the time.
            window: Duration::from_mins(1),
            // Loading the weights takes under 0.5 s. The limit is twenty times as long, for a machine under
            // load.
            start_limit: Duration::from_secs(10),
            // About twelve ticks, and ten times the longest step measured with 128 agents.
            hang_after: Duration::from_secs(1),
        }
    }
}
