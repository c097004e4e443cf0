//! The promises of a run, each as a rule about its history.

use std::collections::{BTreeMap, BTreeSet};

use wire::{Cause, Quality, StageId};

use crate::checker::{Facts, ForecastSeen, Line, Outage, Output};

/// Movement of an agent after which the same controls cannot be a new forecast.
const MOVED_MIN_M: f32 = 0.05;

wire::named! {
    /// A promise that a run must keep.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Promise {
        /// No tick arrives twice or after a later one.
        TicksInOrder => "ticks that came twice or back in order",
        /// Each stamp is later than the previous one.
        StampsInOrder => "stamps that are not after the one before",
        /// A missing tick is within an outage, was hit by a fault, or was counted by a stage.
        MissingTicksExplained => "missing ticks that nobody explains",
        /// A forecast that is not learned names its cause.
        CausesNamed => "forecasts not learned and without a cause",
        /// The run has counted every cause that forecasts name.
        CausesCounted => "causes that nobody counted",
        /// A learned forecast has age 0. A held one has the age of the learned forecast that it repeats.
        AgesRight => "forecasts with a wrong age",
        /// A learned forecast belongs to its own tick.
        LearnedAreOfTheirTick => "forecasts of another tick called learned",
        /// No output is older on arrival than the policy allows, unless it is counted as late.
        NothingStale => "stale forecasts published as fresh",
        /// No number is impossible.
        NumbersPossible => "impossible numbers",
        /// A stage is restarted only if the run reports a death.
        RestartsReported => "restarts that nobody reports",
        /// Stages that are not the target of a fault are not restarted.
        OthersUntouched => "restarts of others",
        /// No file and no process is left.
        NothingLeft => "files or stages left",
    }
}

/// A promise, and how often it was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    pub promise: Promise,
    /// Number of violations.
    pub count: u64,
    /// The first violation in words; empty if the promise was kept.
    pub first: String,
}

/// Data gathered from a history before the checks.
struct History<'a> {
    lines: &'a [Line],
    facts: &'a Facts,
    /// Outputs that belong to their tick, in order of arrival.
    valid: Vec<&'a Output>,
    /// Ticks with at least one output.
    seen: BTreeSet<u64>,
}

/// Checks a history against all promises. Returns one finding per promise, in their order.
#[must_use]
pub fn check(lines: &[Line]) -> Vec<Finding> {
    let nothing = Facts::default();
    let facts =
        lines.iter().rev().find_map(|line| if let Line::Facts(facts) = line { Some(&**facts) } else { None });
    let outputs = || lines.iter().filter_map(Line::output);
    let history = History {
        lines,
        facts: facts.unwrap_or(&nothing),
        // A void frame does not belong to its tick.
        valid: outputs().filter(|output| !output.void).collect(),
        seen: outputs().map(|output| output.tick).collect(),
    };
    let mut found = Broken::default();
    history.order(&mut found);
    history.missing(&mut found);
    history.causes(&mut found);
    history.ages(&mut found);
    history.freshness(&mut found);
    history.restarts(&mut found);
    history.rest(&mut found);
    let finding = |promise| {
        let (count, first) = found.0.get(&promise).cloned().unwrap_or_default();
        Finding { promise, count, first }
    };
    Promise::ALL.map(finding).into()
}

/// For each promise, the number of violations and the first one.
#[derive(Default)]
struct Broken(BTreeMap<Promise, (u64, String)>);

impl Broken {
    fn add(&mut self, promise: Promise, count: u64, how: impl FnOnce() -> String) {
        if count > 0 {
            let entry = self.0.entry(promise).or_insert_with(|| (0, how()));
            entry.0 += count;
        }
    }
}

impl History<'_> {
    fn order(&self, broken: &mut Broken) {
        for (a, b) in self.valid.iter().zip(self.valid.iter().skip(1)) {
            broken.add(Promise::TicksInOrder, u64::from(b.tick <= a.tick), || {
                format!("tick {} after tick {}", b.tick, a.tick)
            });
            let is_back = b.stamp_ns <= a.stamp_ns && !b.new_session;
            broken.add(Promise::StampsInOrder, u64::from(is_back), || {
                format!(
                    "tick {} has stamp {} ns, tick {} before it {} ns",
                    b.tick, b.stamp_ns, a.tick, a.stamp_ns
                )
            });
        }
    }

    /// Ticks on which a fault has acted, on a topic that forecasts wait for.
    fn acted_on(&self) -> BTreeSet<u64> {
        let tick = |line: &Line| match line {
            Line::Injected { tick, topic, .. } if !self.facts.off_path_topics.contains(topic) => Some(*tick),
            _ => None,
        };
        self.lines.iter().filter_map(tick).collect()
    }

    /// Checks a run up to its newest tick if the run was ended early.
    fn missing(&self, broken: &mut Broken) {
        let (acted_on, alone): (_, BTreeSet<u64>) =
            (self.acted_on(), self.facts.recorded_alone.iter().copied().collect());
        let newest = self.seen.iter().chain(&alone).max().map_or(0, |newest| newest + 1);
        let lies_in = |outage: &Outage, tick: u64| {
            let end = outage.ticks_to_learned.map_or(u64::MAX, |ticks| outage.tick.saturating_add(ticks));
            (outage.tick..=end).contains(&tick)
        };
        let is_explained =
            |tick: &u64| acted_on.contains(tick) || self.facts.outages.iter().any(|o| lies_in(o, *tick));
        let missing: Vec<u64> = (0..self.facts.ticks.unwrap_or(newest))
            .filter(|tick| !self.seen.contains(tick) && !alone.contains(tick) && !is_explained(tick))
            .collect();
        // A loss in another stage does not suppress the answer, and neither does a loss of controls in the
        // sampler.
        let of =
            |counts: &BTreeMap<String, u64>, stage: StageId| counts.get(stage.name()).copied().unwrap_or(0);
        let counted = of(&self.facts.lost, StageId::Tracker)
            + of(&self.facts.lost, StageId::Recorder)
            + of(&self.facts.unanswered, StageId::Sampler);
        let without = (missing.len() as u64).saturating_sub(counted);
        broken.add(Promise::MissingTicksExplained, without, || {
            format!("tick {}; {counted} lost frames are counted on the way", missing[0])
        });
    }

    fn causes(&self, broken: &mut Broken) {
        let mut seen: BTreeMap<&str, u64> = BTreeMap::new();
        for output in &self.valid {
            for forecast in output.forecasts.iter().filter(|forecast| !forecast.is_learned()) {
                *seen.entry(&forecast.cause).or_default() += 1;
                let is_named = Cause::ALL.iter().any(|c| *c != Cause::None && c.name() == forecast.cause);
                broken.add(Promise::CausesNamed, u64::from(!is_named), || {
                    format!("tick {}, track {}: \"{}\"", output.tick, forecast.id, forecast.cause)
                });
            }
        }
        // The counts are incomplete if the recorder has died or lost a frame.
        let is_complete = self.facts.reported
            && self.facts.ticks.is_some()
            && self.facts.outages_unlisted == 0
            && self.facts.lost.get(StageId::Recorder.name()).is_none_or(|lost| *lost == 0)
            && self.facts.outages.iter().all(|outage| outage.stage != StageId::Recorder.name());
        for (cause, seen) in seen.into_iter().filter(|_| is_complete) {
            let counted = self.facts.causes.get(cause).copied().unwrap_or(0);
            broken.add(Promise::CausesCounted, seen.saturating_sub(counted), || {
                format!("{seen} forecasts with cause \"{cause}\", {counted} counted")
            });
        }
    }

    /// Checks ages against the newest observed model forecast of each track.
    fn ages(&self, broken: &mut Broken) {
        let mut learned: BTreeMap<u64, &Output> = BTreeMap::new();
        for output in &self.valid {
            for forecast in &output.forecasts {
                let wrong = if forecast.quality == Quality::Held.name() {
                    self.wrong_age(output, forecast, learned.get(&forecast.id).copied())
                } else {
                    (forecast.age_ns > 0)
                        .then(|| format!("{} and {} ns old", forecast.quality, forecast.age_ns))
                };
                if let Some(wrong) = wrong {
                    broken.add(Promise::AgesRight, 1, || {
                        format!("tick {}, track {}: {wrong}", output.tick, forecast.id)
                    });
                }
                if forecast.is_of_the_model() {
                    learned.insert(forecast.id, output);
                }
            }
        }
    }

    /// What is wrong with the age of a held forecast. The age may be less than the time since the newest
    /// observed learned forecast if ticks in between were missed.
    fn wrong_age(
        &self,
        output: &Output,
        forecast: &ForecastSeen,
        learned: Option<&Output>,
    ) -> Option<String> {
        let age_ns = forecast.age_ns as i64;
        let Some(learned) = learned else {
            return (age_ns == 0).then(|| "held and 0 ns old".to_owned());
        };
        let since_ns = output.stamp_ns - learned.stamp_ns;
        let between = learned.tick.saturating_add(1)..output.tick.max(learned.tick.saturating_add(1));
        let missed = between.end - between.start - self.seen.range(between.clone()).count() as u64;
        let is_right = age_ns == since_ns || (missed > 0 && age_ns > 0 && age_ns < since_ns);
        (!is_right).then(|| format!("held and {age_ns} ns old, {since_ns} ns after it was learned"))
    }

    fn freshness(&self, broken: &mut Broken) {
        // If the decoder is a program that leaves no trace, no frame of the run has one.
        let decoder = StageId::Decoder.name();
        let has_traces = self.valid.iter().any(|output| output.incarnations.contains_key(decoder));
        let mut prints: BTreeMap<u64, (u32, [f32; 2], u64)> = BTreeMap::new();
        let mut stale: Vec<&Output> = Vec::new();
        for output in &self.valid {
            let late_ns = output.received_ns.saturating_sub(output.released_ns);
            let is_late = self.facts.held_max_ns.is_some_and(|most| late_ns > most) && !self.facts.lockstep;
            if is_late && output.forecasts.iter().any(ForecastSeen::is_learned) {
                stale.push(output);
            }
            for forecast in output.forecasts.iter().filter(|forecast| forecast.is_learned()) {
                let came_by = !has_traces || output.incarnations.contains_key(decoder);
                broken.add(Promise::LearnedAreOfTheirTick, u64::from(!came_by), || {
                    format!("tick {}, track {}: it has not passed the decoder", output.tick, forecast.id)
                });
                let before = prints.insert(forecast.id, (forecast.print, forecast.at_m, output.tick));
                let Some((print, at_m, tick)) = before else { continue };
                let moved_m = (forecast.at_m[0] - at_m[0]).hypot(forecast.at_m[1] - at_m[1]);
                let is_same = forecast.print == print && print != 0 && moved_m > MOVED_MIN_M;
                broken.add(Promise::LearnedAreOfTheirTick, u64::from(is_same), || {
                    format!(
                        "tick {}, track {}: the controls are those of tick {tick}",
                        output.tick, forecast.id
                    )
                });
            }
        }
        let uncounted = (stale.len() as u64).saturating_sub(self.facts.late_ticks);
        broken.add(Promise::NothingStale, uncounted, || {
            let late_ns = stale[0].received_ns - stale[0].released_ns;
            format!("tick {}: learned, {late_ns} ns after its release", stale[0].tick)
        });
        let held = |forecast: &&ForecastSeen| forecast.quality == Quality::Held.name();
        for output in &self.valid {
            for forecast in output.forecasts.iter().filter(held) {
                let is_stale = self.facts.held_max_ns.is_some_and(|most| forecast.age_ns > most);
                broken.add(Promise::NothingStale, u64::from(is_stale), || {
                    format!("tick {}, track {}: held for {} ns", output.tick, forecast.id, forecast.age_ns)
                });
            }
        }
    }

    fn restarts(&self, broken: &mut Broken) {
        let mut newest: BTreeMap<&str, u32> = BTreeMap::new();
        let mut see = |stage, incarnation: u32| {
            let newest = newest.entry(stage).or_default();
            *newest = incarnation.max(*newest);
        };
        for line in self.lines {
            match line {
                Line::Forecasts(output) => output.incarnations.iter().for_each(|(stage, i)| see(stage, *i)),
                Line::Reached { stage, incarnation, .. } => see(stage, *incarnation),
                _ => {}
            }
        }
        let (facts, targets) = (self.facts, &self.facts.targets);
        if facts.reported && facts.outages_unlisted == 0 {
            for (stage, seen) in newest {
                let deaths = facts.outages.iter().filter(|outage| outage.stage == stage).count() as u64;
                broken.add(Promise::RestartsReported, u64::from(seen).saturating_sub(deaths), || {
                    format!("the {stage} is process {}, {deaths} deaths are reported", seen + 1)
                });
            }
        }
        let others: Vec<&Outage> = facts.outages.iter().filter(|o| !targets.contains(&o.stage)).collect();
        broken.add(
            Promise::OthersUntouched,
            (others.len() as u64).saturating_sub(facts.restarts_of_others),
            || format!("the {} after tick {}", others[0].stage, others[0].tick),
        );
    }

    fn rest(&self, broken: &mut Broken) {
        for output in &self.valid {
            if let Some(what) = &output.impossible {
                broken.add(Promise::NumbersPossible, 1, || format!("tick {}: {what}", output.tick));
            }
        }
        let Facts { files_left, stages_left, leftovers, .. } = *self.facts;
        broken.add(Promise::NothingLeft, files_left.saturating_sub(leftovers) + stages_left, || {
            format!("{files_left} files, {stages_left} stages")
        });
    }
}
