//! Decides when a flight recorder writes its buffer: the causes, and the start, extension and end of files.

use crate::{Event, Happened};

/// Maximum time that a file continues after its first cause, in multiples of [`FlightLimits::after_ns`]. An
/// endless series of causes therefore does not fill the disk.
pub const JOINED_MAX: u64 = 6;

/// Limits on the output of a flight recorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlightLimits {
    /// Time that a file continues after its cause.
    pub after_ns: u64,
    /// Maximum number of files of a recording.
    pub files: u32,
}

/// The next action of a flight recorder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Act {
    /// Only buffers the messages.
    Keep,
    /// Starts the file with this number, from 1, with the content of the ring.
    Begin(u32),
    /// Extends the current file.
    Join,
    /// Writes nothing: the maximum number of files is reached.
    Full,
}

/// Decides when a flight recorder starts and ends its files. A cause while a file is written extends that
/// file. If the same cause recurs before it has been quiet for `after_ns`, it is the same event.
#[derive(Clone, Debug)]
pub struct Flight {
    limits: FlightLimits,
    files: u32,
    /// Start and end of the current file.
    open: Option<[u64; 2]>,
    /// When each cause last occurred.
    seen: Vec<(Trigger, u64)>,
    missed: u64,
}

/// Kinds of causes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// A tick has forecasts that are not learned, for another reason than the agent itself.
    Degraded,
    /// Forecasts arrived after the end of their tick.
    Late,
    /// A stage has died, was given up or replaced, or gets no CPU.
    Stage,
    /// A user asked for it: `stgdat mark` or a signal.
    Asked,
}

impl Flight {
    /// A flight recorder that has written nothing.
    #[must_use]
    pub const fn new(limits: FlightLimits) -> Self {
        Self { limits, files: 0, open: None, seen: Vec::new(), missed: 0 }
    }

    /// Handles a cause.
    pub fn cause(&mut self, trigger: Trigger, at_ns: u64) -> Act {
        let quiet_ns = self.limits.after_ns;
        let is_same = match self.seen.iter_mut().find(|(seen, _)| *seen == trigger) {
            Some((_, last_ns)) => at_ns < std::mem::replace(last_ns, at_ns).saturating_add(quiet_ns),
            None => {
                self.seen.push((trigger, at_ns));
                false
            }
        };
        // A user's request is always a new event.
        if is_same && trigger != Trigger::Asked {
            return Act::Keep;
        }
        let until_ns = at_ns.saturating_add(self.limits.after_ns);
        if let Some([begin_ns, end_ns]) = &mut self.open {
            let most_ns = begin_ns.saturating_add(JOINED_MAX.saturating_mul(self.limits.after_ns));
            *end_ns = until_ns.min(most_ns).max(*end_ns);
            return Act::Join;
        }
        if self.files >= self.limits.files {
            self.missed += 1;
            return Act::Full;
        }
        self.files += 1;
        self.open = Some([at_ns, until_ns]);
        Act::Begin(self.files)
    }

    /// Whether the current file ends now; if so, it is closed.
    pub fn ends(&mut self, now_ns: u64) -> bool {
        self.open.take_if(|[_, end_ns]| now_ns >= *end_ns).is_some()
    }

    /// Number of files started.
    pub const fn files(&self) -> u32 {
        self.files
    }

    /// Number of events after the last allowed file.
    pub const fn missed(&self) -> u64 {
        self.missed
    }
}

/// The kind of cause that an event is; `None` if it is not a cause.
#[must_use]
pub const fn caused_by(event: &Event) -> Option<Trigger> {
    match event.what {
        Happened::Died { .. }
        | Happened::GivenUp { .. }
        | Happened::Starved { .. }
        | Happened::Replaced { .. } => Some(Trigger::Stage),
        Happened::Mark { .. } => Some(Trigger::Asked),
        Happened::Linked
        | Happened::Refused { .. }
        | Happened::Lost { .. }
        | Happened::Kept { .. }
        | Happened::Ended { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const S: u64 = 1_000_000_000;

    fn flight() -> Flight {
        Flight::new(FlightLimits { after_ns: 5 * S, files: 2 })
    }

    #[test]
    fn events_that_overlap_are_joined_and_files_are_limited() {
        let mut flight = flight();
        assert_eq!(flight.cause(Trigger::Late, S), Act::Begin(1));
        assert_eq!(flight.cause(Trigger::Late, 2 * S), Act::Keep, "the same event goes on");
        assert_eq!(flight.cause(Trigger::Stage, 4 * S), Act::Join);
        assert!(!flight.ends(8 * S) && flight.ends(9 * S) && flight.open.is_none());
        assert_eq!(flight.cause(Trigger::Asked, 20 * S), Act::Begin(2));
        assert_eq!(flight.cause(Trigger::Asked, 21 * S), Act::Join, "who asks twice means it");
        assert!(flight.ends(26 * S));
        assert_eq!(flight.cause(Trigger::Stage, 40 * S), Act::Full);
        assert_eq!((flight.files(), flight.missed()), (2, 1));
    }

    proptest! {
        /// For any sequence of causes: the number of files and the duration of each file stay within their
        /// limits.
        #[test]
        fn files_keep_their_limits(causes in prop::collection::vec((0..4_usize, 0..4 * S), 1..200)) {
            let all = [Trigger::Degraded, Trigger::Late, Trigger::Stage, Trigger::Asked];
            let (mut flight, mut now_ns, mut begun_ns) = (flight(), 0, None);
            for (which, later_ns) in causes {
                now_ns += later_ns;
                if flight.ends(now_ns) {
                    begun_ns = None;
                }
                if let Act::Begin(number) = flight.cause(all[which], now_ns) {
                    prop_assert!(begun_ns.is_none() && number <= 2);
                    begun_ns = Some(now_ns);
                }
                prop_assert_eq!(begun_ns.is_some(), flight.open.is_some());
                prop_assert!(begun_ns.is_none_or(|begun| now_ns - begun <= JOINED_MAX * 5 * S));
            }
        }
    }
}
