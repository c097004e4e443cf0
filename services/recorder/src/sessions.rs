//! Sessions: the parts of a run in which the stamps have one clock.

use audit::{ClockSet, Doubt, Found};
use serde::{Deserialize, Serialize};
use wire::Header;

use crate::input::InputReport;

/// Largest number of steps of the clock that a report names.
const NAMED_MAX: usize = 16;

/// The sessions of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Sessions {
    /// Number of sessions; 0 before the first tick.
    pub count: u64,
    /// The steps of the clock at which sessions began: the first sixteen.
    pub clock_set: Vec<ClockSet>,
    /// Number and stamp of the newest published tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) newest: Option<(u64, i64)>,
}

impl Sessions {
    /// Adds a published tick. Returns the difference between its stamp and the expected one if it begins a
    /// session.
    pub(crate) fn tick(&mut self, header: &Header) -> Option<i64> {
        let newest = self.newest.replace((header.seq, header.stamp_ns));
        self.count = self.count.max(1);
        let (seq, stamp_ns) = newest.filter(|newest| header.begins_session_after(*newest))?;
        self.count += 1;
        let passed_ns = header.interval_ns.saturating_mul(header.seq - seq);
        let by_ns = header.stamp_ns.saturating_sub(stamp_ns.saturating_add_unsigned(passed_ns));
        if self.clock_set.len() < NAMED_MAX {
            self.clock_set.push(ClockSet::new(header.seq, by_ns));
        }
        Some(by_ns)
    }

    /// Whether a tick is not newer than the newest one. A tick without tracks begins no session.
    pub(crate) fn is_old(&self, header: &Header) -> bool {
        self.newest.is_some_and(|newest| header.stamp_ns <= newest.1 && !header.begins_session_after(newest))
    }

    /// The report, without what only the count needs.
    pub(crate) fn report(&self) -> Self {
        Self { newest: None, ..self.clone() }
    }

    /// Names the steps back in place of the doubt that stamps go back.
    pub(crate) fn name_steps(&self, input: &mut InputReport) {
        let mut back = self.clock_set.iter().filter(|set| set.is_back());
        let Some(first) = back.next() else { return };
        let others = match back.count() {
            0 => String::new(),
            others => format!(", and {others} times more"),
        };
        let sentence = format!("{first}{others}: was the clock set, or does a recording begin again?");
        let kind = Doubt::StampsGoBack.name();
        input.findings.retain(|found| found.kind != kind);
        input.findings.push(Found { sentence, ..Found::of_kind(Doubt::StampsGoBack) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::flags;

    #[test]
    fn steps_of_the_clock_are_counted_and_named() {
        let mut sessions = Sessions::default();
        let tick = |seq: u64, tenths: i64| Header {
            interval_ns: 100_000_000,
            ..Header::new(1, seq, tenths * 100_000_000)
        };
        for seq in 0..10 {
            assert_eq!(sessions.tick(&tick(seq, 50 + seq as i64)), None);
        }
        // Tick 10 was refused.
        assert!(sessions.is_old(&tick(9, 59)) && !sessions.is_old(&tick(11, 50)));
        let void = Header { flags: flags::VOID, ..tick(10, 50) };
        assert!(sessions.is_old(&void), "a tick without tracks begins no session");
        assert_eq!(sessions.tick(&tick(11, 50)), Some(-1_100_000_000));
        assert_eq!(
            sessions.tick(&Header { flags: flags::NEW_SESSION, ..tick(12, 200) }),
            Some(14_900_000_000)
        );
        assert_eq!(sessions.count, 3);
        let mut input = InputReport::default();
        sessions.name_steps(&mut input);
        let doubts: Vec<String> = input.doubts().map(ToString::to_string).collect();
        let expected =
            "the stamps go back by 1.10 s at tick 11: was the clock set, or does a recording begin again?";
        assert_eq!(doubts, [expected]);
    }
}
