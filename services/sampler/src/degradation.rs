//! The published forecast of an agent without a learned forecast: a state machine without clock or memory.
//!
//! Learned forecasts are held, then zero control replaces them, and finally no forecast is published. A
//! planner can therefore see that a forecast is missing. A new learned forecast returns the agent to the
//! learned level at once.

/// The kind of forecast that is published for an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// The learned forecast of this tick.
    Learned,
    /// The last learned forecast, moved on to the present.
    Held,
    /// Zero control.
    Kinematic,
    /// No forecast.
    Silent,
}

/// The reason for a change of level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// The controls of the tick can be used.
    Controls,
    /// The controls are late, missing or refused.
    NoControls,
    /// The last learned forecast is older than `held_s`, or there is none.
    TooOld,
    /// There has been no learned forecast for `kinematic_s` longer than that.
    TooLong,
}

/// All transitions; docs/degradation.md draws them.
pub const TRANSITIONS: [(Level, Change, Level); 7] = [
    (Level::Learned, Change::NoControls, Level::Held),
    (Level::Learned, Change::TooOld, Level::Kinematic),
    (Level::Held, Change::TooOld, Level::Kinematic),
    (Level::Kinematic, Change::TooLong, Level::Silent),
    (Level::Held, Change::Controls, Level::Learned),
    (Level::Kinematic, Change::Controls, Level::Learned),
    (Level::Silent, Change::Controls, Level::Learned),
];

/// How long each level may last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Degradation {
    /// Maximum age at which a learned forecast is republished as held.
    pub held_ns: u64,
    /// Duration for which an agent is then forecast by zero control; `None` for no limit.
    pub kinematic_ns: Option<u64>,
}

impl Default for Degradation {
    fn default() -> Self {
        Self { held_ns: 1_600_000_000, kinematic_ns: None }
    }
}

impl Degradation {
    /// The level of an agent without controls in this tick, whose last learned forecast has this age. For an
    /// agent that never had one, `without_ns` counts: the time for which the whole scene has had none.
    #[must_use]
    pub fn level(&self, age_ns: Option<u64>, without_ns: u64) -> Level {
        let over_ns = match age_ns {
            Some(age_ns) if age_ns <= self.held_ns => return Level::Held,
            Some(age_ns) => age_ns - self.held_ns,
            None => without_ns.saturating_sub(self.held_ns),
        };
        match self.kinematic_ns {
            Some(limit_ns) if over_ns > limit_ns => Level::Silent,
            _ => Level::Kinematic,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn each_level_follows_the_one_before() {
        let policy = Degradation { held_ns: 500 * MS, kinematic_ns: Some(1_000 * MS) };
        let levels = [80, 500, 580, 1_500, 1_580].map(|age_ms| policy.level(Some(age_ms * MS), 0));
        use Level::{Held, Kinematic, Silent};
        assert_eq!(levels, [Held, Held, Kinematic, Kinematic, Silent]);
        let never = [0, 1_500, 1_580].map(|ms| policy.level(None, ms * MS));
        assert_eq!(never, [Kinematic, Kinematic, Silent], "a new agent counts the scene's time");
    }

    proptest! {
        /// Without controls the level never improves. It follows the table, possibly by several transitions
        /// at once.
        #[test]
        fn levels_only_fall_and_by_the_table(
            held_ns in 0..5_000 * MS,
            kinematic_ns in proptest::option::of(0..5_000 * MS),
            step_ns in MS..900 * MS,
            has_one in any::<bool>(),
        ) {
            let policy = Degradation { held_ns, kinematic_ns };
            let mut level = if has_one { Level::Learned } else { Level::Kinematic };
            for tick in 1..60 {
                let elapsed_ns = tick * step_ns;
                let (age_ns, without_ns) = if has_one { (Some(elapsed_ns), 0) } else { (None, elapsed_ns) };
                let next = policy.level(age_ns, without_ns);
                prop_assert!(next >= level && next > Level::Learned);
                let mut reached = level;
                while reached != next {
                    let on = |(from, change, to): &(Level, Change, Level)| {
                        *from == reached && *change != Change::Controls && *to <= next
                    };
                    let step = TRANSITIONS.iter().find(|transition| on(transition));
                    reached = step.expect("the table leads there").2;
                }
                level = next;
            }
            if kinematic_ns.is_none() {
                prop_assert!(level < Level::Silent, "without a limit something is always said");
            }
        }
    }

    #[test]
    fn every_level_leads_back_to_learned() {
        for level in [Level::Held, Level::Kinematic, Level::Silent] {
            assert!(TRANSITIONS.contains(&(level, Change::Controls, Level::Learned)));
        }
    }

    /// The diagram of the page matches the table.
    #[test]
    fn the_page_draws_the_transitions() {
        let name = |level: Level| format!("{level:?}").to_lowercase();
        let mut drawn = String::from("```mermaid\nstateDiagram-v2\n    [*] --> kinematic\n");
        for (from, change, to) in TRANSITIONS {
            let change = match change {
                Change::Controls => "controls",
                Change::NoControls => "no controls",
                Change::TooOld => "older than held_s",
                Change::TooLong => "kinematic_s longer",
            };
            drawn += &format!("    {} --> {}: {change}\n", name(from), name(to));
        }
        drawn += "```\n";
        let page = include_str!("../../../docs/degradation.md");
        assert!(page.contains(&drawn), "docs/degradation.md lacks:\n{drawn}");
    }
}
