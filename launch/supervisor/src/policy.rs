//! When a stage that has ended is started again: a state machine without clock or process.
//!
//! ```text
//!            ended, policy allows            pause over, cleaned up
//! running ─────────────────────────▶ waiting ──────────────────────▶ running, incarnation + 1
//!    │ ended: done
//!    ├──────────────▶ done
//!    │ ended: exit 78, policy forbids, or too often
//!    └──────────────▶ given up, for good
//! ```
//!
//! A stage that ends while there is no room for its files is started again every second. A source that ends
//! before the run has begun, such as a detector without a camera, is started again with growing pauses. These
//! restarts have no limit.

use std::collections::VecDeque;
use std::time::Duration;

use crate::restart::{Restart, RestartPolicy};

/// Pause before the restart of a stage that ended while there was no room.
const NO_ROOM_PAUSE: Duration = Duration::from_secs(1);

/// How a process ended, as far as the policy depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With exit code 0 because its work is done: source and recorder.
    Done,
    /// With exit code 0 during the run.
    Success,
    /// With exit code 78: its configuration can't be used.
    Config,
    /// With another exit code or by a signal, while there was no room for its files.
    NoRoom,
    /// With another exit code or by a signal: a source that is not ready before the run has begun.
    NotReady,
    /// With another exit code or by a signal.
    Failure,
}

/// The state of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The process is running.
    Running {
        /// When it was started.
        since: Duration,
        /// Whether it has been linked to its neighbours.
        linked: bool,
    },
    /// The process has ended. It is restarted once the pause is over.
    Waiting {
        /// When the pause is over.
        until: Duration,
    },
    /// The process has ended with its work done.
    Done,
    /// The process has ended and will not be restarted.
    GivenUp {
        /// The reason, phrased to follow "given up: ".
        why: &'static str,
    },
}

/// The state of one stage under its policy. All times come from one monotonic clock.
#[derive(Clone, Debug)]
pub struct Supervision {
    policy: RestartPolicy,
    state: State,
    incarnation: u32,
    /// Times of the restarts within the window, oldest first.
    restarts: VecDeque<Duration>,
    /// Number of ends as [`End::NotReady`].
    not_ready: u32,
}

impl Supervision {
    /// Creates the state of a stage that was started for the first time.
    pub const fn new(policy: RestartPolicy, now: Duration) -> Self {
        let state = State::Running { since: now, linked: false };
        Self { policy, state, incarnation: 0, restarts: VecDeque::new(), not_ready: 0 }
    }

    /// The state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Returns the number of restarts.
    pub const fn incarnation(&self) -> u32 {
        self.incarnation
    }

    /// The policy.
    pub const fn policy(&self) -> &RestartPolicy {
        &self.policy
    }

    /// Records the end of the process.
    pub fn ended(&mut self, end: End, now: Duration) -> State {
        let window = self.policy.window;
        while self.restarts.front().is_some_and(|&oldest| now.saturating_sub(oldest) > window) {
            self.restarts.pop_front();
        }
        let given_up = |why| State::GivenUp { why };
        self.state = match (end, self.policy.restart) {
            (End::Done, _) => State::Done,
            (End::Config, _) => given_up("its configuration can't be used"),
            (_, Restart::Never) => given_up("its policy is never to restart it"),
            // Not the stage's fault. It starts once there is room again.
            (End::NoRoom, _) => State::Waiting { until: now + NO_ROOM_PAUSE },
            // As above: the device of a detector may need a minute after the boot.
            (End::NotReady, _) => {
                self.not_ready = self.not_ready.saturating_add(1);
                State::Waiting { until: now + self.pause(self.not_ready as usize) }
            }
            (End::Success, Restart::OnFailure) => given_up("it ended by itself, which is no failure"),
            _ if self.restarts.len() >= self.policy.restarts_max as usize => {
                given_up("it was restarted too often")
            }
            _ => {
                self.restarts.push_back(now);
                State::Waiting { until: now + self.pause(self.restarts.len()) }
            }
        };
        self.state
    }

    /// Returns the pause before the restart of this number. The first restart has no pause; then come the
    /// backoff, twice the backoff, and so on.
    fn pause(&self, restart: usize) -> Duration {
        match restart.saturating_sub(2) {
            _ if restart < 2 => Duration::ZERO,
            doublings => {
                let factor = 1_u32.checked_shl(doublings as u32).unwrap_or(u32::MAX);
                self.policy.backoff.saturating_mul(factor).min(RestartPolicy::BACKOFF_MAX)
            }
        }
    }

    /// Whether the pause before a restart is over.
    pub fn is_due(&self, now: Duration) -> bool {
        matches!(self.state, State::Waiting { until } if now >= until)
    }

    /// Whether the source was not ready and the run has not begun since.
    pub const fn is_awaited(&self) -> bool {
        self.not_ready > 0
    }

    /// Records that the run has begun.
    pub const fn begun(&mut self) {
        self.not_ready = 0;
    }

    /// Records a restart of the process.
    pub const fn restarted(&mut self, now: Duration) {
        self.incarnation = self.incarnation.saturating_add(1);
        self.state = State::Running { since: now, linked: false };
    }

    /// Records that another process took over while this one ran, which does not count as a restart.
    pub const fn replaced(&mut self, now: Duration) {
        self.restarted(now);
    }

    /// Records that the replacement failed. The previous program is started again at once, which does not
    /// count as a restart either.
    pub const fn rolled_back(&mut self, now: Duration) {
        self.state = State::Waiting { until: now };
    }

    /// Records that the process is linked to its neighbours.
    pub const fn linked(&mut self) {
        if let State::Running { linked, .. } = &mut self.state {
            *linked = true;
        }
    }

    /// Whether a restarted process has missed its deadline for linking.
    pub fn is_overdue(&self, now: Duration) -> bool {
        self.incarnation > 0 && self.is_stuck(now)
    }

    /// Whether a process, even the first one, was not linked within the limit of a restarted one.
    pub fn is_stuck(&self, now: Duration) -> bool {
        let State::Running { since, linked: false } = self.state else { return false };
        now.saturating_sub(since) > self.policy.start_limit
    }

    /// Shifts running deadlines by the time for which the launcher itself was stopped.
    pub fn forgive(&mut self, stopped: Duration) {
        match &mut self.state {
            State::Running { since: at, .. } | State::Waiting { until: at } => *at += stopped,
            State::Done | State::GivenUp { .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn supervision(restart: Restart) -> Supervision {
        Supervision::new(RestartPolicy { restart, ..RestartPolicy::default() }, Duration::ZERO)
    }

    #[test]
    fn exit_code_78_is_given_up_under_every_policy() {
        for restart in [Restart::Never, Restart::OnFailure, Restart::Always] {
            let mut stage = supervision(restart);
            assert!(matches!(stage.ended(End::Config, SECOND), State::GivenUp { .. }), "{restart:?}");
        }
    }

    #[test]
    fn the_policy_decides_about_success_and_failure() {
        let waits = |restart, end| matches!(supervision(restart).ended(end, SECOND), State::Waiting { .. });
        assert_eq!([End::Success, End::Failure].map(|end| waits(Restart::Never, end)), [false, false]);
        assert_eq!([End::Success, End::Failure].map(|end| waits(Restart::OnFailure, end)), [false, true]);
        assert_eq!([End::Success, End::Failure].map(|end| waits(Restart::Always, end)), [true, true]);
        assert_eq!(supervision(Restart::Always).ended(End::Done, SECOND), State::Done);
    }

    #[test]
    fn the_first_restart_is_at_once_and_the_pauses_double() {
        let mut stage = supervision(Restart::OnFailure);
        let mut pauses_ms = Vec::new();
        for death in 1..=5 {
            let State::Waiting { until } = stage.ended(End::Failure, SECOND * death) else {
                panic!("given up at death {death}");
            };
            pauses_ms.push((until - SECOND * death).as_millis());
            stage.restarted(until);
        }
        assert_eq!(pauses_ms, [0, 80, 160, 320, 640]);
        assert!(matches!(stage.ended(End::Failure, SECOND * 6), State::GivenUp { .. }));
        assert_eq!(stage.incarnation(), 5);
    }

    #[test]
    fn a_start_has_a_deadline_that_moves_with_a_stop_of_the_launcher() {
        let mut stage = supervision(Restart::OnFailure);
        assert!(!stage.is_overdue(SECOND * 100), "the first start has a limit of the run's own");
        assert!(stage.is_stuck(SECOND * 100) && !stage.is_stuck(SECOND * 9));
        stage.ended(End::Failure, SECOND);
        stage.restarted(SECOND);
        assert!(!stage.is_overdue(SECOND * 11) && stage.is_overdue(SECOND * 12));
        stage.forgive(SECOND * 5);
        assert!(!stage.is_overdue(SECOND * 16) && stage.is_overdue(SECOND * 17));
        stage.linked();
        assert!(!stage.is_overdue(SECOND * 100));
    }

    /// A xorshift generator: updates the state and returns the next number.
    fn next(state: &mut u64) -> u64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        *state
    }

    #[test]
    fn ends_for_lack_of_room_never_count() {
        let mut stage = supervision(Restart::OnFailure);
        for second in 1..200 {
            let now = SECOND * second;
            assert_eq!(stage.ended(End::NoRoom, now), State::Waiting { until: now + NO_ROOM_PAUSE });
            stage.restarted(now + NO_ROOM_PAUSE);
        }
        assert_eq!(stage.ended(End::Failure, SECOND * 200), State::Waiting { until: SECOND * 200 });
        assert!(matches!(supervision(Restart::Never).ended(End::NoRoom, SECOND), State::GivenUp { .. }));
    }

    #[test]
    fn a_source_that_is_not_ready_is_awaited_without_a_limit_by_its_policy() {
        let mut stage = supervision(Restart::OnFailure);
        let mut pauses_ms = Vec::new();
        for number in 1..=100 {
            let now = SECOND * 10 * number;
            let State::Waiting { until } = stage.ended(End::NotReady, now) else { panic!("given up") };
            pauses_ms.push((until - now).as_millis());
            stage.restarted(until);
        }
        assert_eq!(pauses_ms[..9], [0, 80, 160, 320, 640, 1280, 2560, 4000, 4000]);
        assert_eq!(pauses_ms[99], 4000);
        assert!(stage.is_awaited());
        stage.begun();
        assert!(!stage.is_awaited());
        assert_eq!(stage.ended(End::Failure, SECOND * 2000), State::Waiting { until: SECOND * 2000 });
        assert!(matches!(supervision(Restart::Never).ended(End::NotReady, SECOND), State::GivenUp { .. }));
    }

    #[test]
    fn random_lives_keep_the_limits() {
        let ends = [End::Success, End::Config, End::Failure, End::Failure, End::Failure, End::Failure];
        for seed in 1..=2_000_u64 {
            let mut random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let policy = RestartPolicy {
                restart: [Restart::Never, Restart::OnFailure, Restart::Always][(seed % 3) as usize],
                backoff: Duration::from_millis(next(&mut random) % 4_000),
                restarts_max: (next(&mut random) % 7 + 1) as u32,
                window: Duration::from_secs(next(&mut random) % 90 + 1),
                ..RestartPolicy::default()
            };
            let (mut stage, mut now) = (Supervision::new(policy, Duration::ZERO), Duration::ZERO);
            let mut starts: Vec<Duration> = Vec::new();
            for _ in 0..60 {
                now += Duration::from_millis(next(&mut random) % 20_000);
                let end = ends[(next(&mut random) % 6) as usize];
                let incarnation = stage.incarnation();
                let deaths = starts.iter().filter(|&&at| now.saturating_sub(at) <= policy.window).count();
                match stage.ended(end, now) {
                    State::Waiting { until } => {
                        assert!(end != End::Config && policy.restart != Restart::Never, "{seed}");
                        assert!(until >= now && until - now <= RestartPolicy::BACKOFF_MAX, "{seed}");
                        assert!(deaths < policy.restarts_max as usize, "seed {seed}: within its limit");
                        assert!(stage.is_due(until), "{seed}");
                        starts.push(now);
                        now = until;
                        stage.restarted(now);
                        assert_eq!(stage.incarnation(), incarnation + 1, "seed {seed}");
                    }
                    State::GivenUp { .. } => {
                        assert!(!stage.is_due(now + SECOND * 1_000), "seed {seed}: for good");
                        break;
                    }
                    other => panic!("seed {seed}: {other:?}"),
                }
            }
        }
    }
}
