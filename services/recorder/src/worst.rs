//! The worst ticks of a run, each with its cause in a sentence.
//!
//! Ticks without forecasts are the worst, followed by the ticks with the longest end-to-end latency. A tick's
//! cause is the stage and phase with the largest excess over its median in the run. If the controls of a tick
//! did not arrive, its own header does not show the cause. The next tick that passes all stages shows it: by
//! a stage that was restarted, or by the stage that takes the tick late.
//!
//! The list reserves room for [`WORST_LEN`] ticks at the start, so a tick does not allocate.

use serde::{Deserialize, Serialize};
use wire::{Cause, StageId, flags};

use crate::distribution::ms;
use crate::passage::{Passage, Phases};
use crate::report::WorstTick;
use crate::text::{count, number};
use crate::tick::Tick;

/// Number of ticks that are kept.
pub const WORST_LEN: usize = 20;
/// A stage that takes the next tick more than this late is behind.
const BEHIND_NS: u64 = 5_000_000;
/// Excess over the median below which a phase counts as usual.
const USUAL_NS: u64 = 300_000;

/// One of the worst ticks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Bad {
    /// Number of the tick. For several ticks without forecasts, the number of the first.
    seq: u64,
    stamp_ns: i64,
    flags: u32,
    /// Number of ticks without forecasts; 0 for a tick with forecasts.
    lost: u64,
    agents: u64,
    not_learned: u64,
    /// Most frequent cause of the forecasts that are not learned, as a number.
    cause: u32,
    passage: Passage,
    /// The first stage on its way that was restarted since the previous tick.
    restarted: Option<StageNumber>,
    /// The reason why the controls of this tick were missing, as shown by the next tick.
    blame: Option<Blame>,
}

/// A stage as its number, for the checkpoint.
type StageNumber = u32;

/// The reason why the controls of a tick were missing.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
enum Blame {
    /// The stage was restarted.
    Restarted(StageNumber),
    /// The stage took its next frame this much later than it was sent.
    Behind(StageNumber, u64),
    /// No stage was behind: the frame was slightly late, lost, or refused on its way.
    Nobody,
}

/// The usual values in a run, with which a tick is compared.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Usual {
    /// Medians of the phases by stage.
    pub phases_ns: [[u64; 4]; StageId::PLACES_LEN],
    /// Mean number of agents.
    pub agents: f64,
}

/// The worst ticks so far, worst first.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Worst {
    ticks: Vec<Bad>,
    /// A tick that is kept in any case, if it has arrived.
    #[serde(skip)]
    explained: Option<Bad>,
}

impl Default for Worst {
    fn default() -> Self {
        Self { ticks: Vec::with_capacity(WORST_LEN + 1), explained: None }
    }
}

impl Bad {
    /// A larger value is worse.
    fn badness(&self) -> (u64, u64) {
        (self.lost, self.passage.end_to_end_ns.unwrap_or(0))
    }
}

impl Worst {
    /// Adds a tick with its passage, and the ticks without forecasts before it. The tick `explain` is always
    /// kept.
    pub fn take(
        &mut self,
        tick: &Tick,
        stamp_ns: i64,
        restarted: Option<StageId>,
        gap: u64,
        explain: Option<u64>,
    ) {
        if tick.passage.complete {
            self.explain(&tick.passage, restarted);
        }
        let (not_learned, cause) = tick.not_learned();
        let bad = Bad {
            seq: tick.seq,
            stamp_ns,
            flags: tick.flags,
            lost: 0,
            agents: tick.agents,
            not_learned,
            cause: cause.map_or(0, |cause| cause as u32),
            passage: tick.passage,
            restarted: restarted.map(|stage| stage.number()),
            blame: None,
        };
        if gap > 0 {
            let first = tick.seq.saturating_sub(gap);
            let passage = Passage::default();
            self.insert(Bad { seq: first, lost: gap, agents: 0, not_learned: 0, cause: 0, passage, ..bad });
        }
        if explain == Some(tick.seq) {
            self.explained = Some(bad);
        }
        self.insert(bad);
    }

    /// Finds the reason why the controls of earlier ticks were missing, from a tick that has passed all
    /// stages.
    fn explain(&mut self, next: &Passage, restarted: Option<StageId>) {
        let behind = |stage: &StageId| {
            let phases = next.phases(*stage)?;
            Some((stage.number(), phases.waiting_ns + phases.wake_up_ns))
        };
        let ends = [StageId::Source, StageId::Tracker, StageId::Sampler, StageId::Recorder];
        let before_sampler: Vec<StageId> = StageId::known().filter(|stage| !ends.contains(stage)).collect();
        let blame = match restarted.filter(|stage| before_sampler.contains(stage)) {
            Some(stage) => Blame::Restarted(stage.number()),
            None => match before_sampler.iter().filter_map(behind).max_by_key(|&(_, late_ns)| late_ns) {
                Some((stage, late_ns)) if late_ns >= BEHIND_NS => Blame::Behind(stage, late_ns),
                _ => Blame::Nobody,
            },
        };
        for bad in self.ticks.iter_mut().chain(&mut self.explained).filter(|bad| bad.lacks_controls()) {
            bad.blame.get_or_insert(blame);
        }
    }

    fn is_bad(&self, bad: &Bad) -> bool {
        self.ticks.len() < WORST_LEN || self.ticks.last().is_some_and(|last| bad.badness() > last.badness())
    }

    fn insert(&mut self, bad: Bad) {
        if self.is_bad(&bad) {
            // Among equal ticks the earlier one stays first.
            let place = self.ticks.partition_point(|other| other.badness() >= bad.badness());
            self.ticks.insert(place, bad);
            self.ticks.truncate(WORST_LEN);
        }
    }

    /// The same, with room for the largest number of ticks.
    pub fn with_room(mut self) -> Self {
        self.ticks.truncate(WORST_LEN);
        self.ticks.reserve_exact(WORST_LEN + 1 - self.ticks.len());
        self
    }

    /// The requested tick, if it has arrived.
    pub fn explained(&self, usual: &Usual) -> Option<WorstTick> {
        self.explained.map(|bad| bad.explain(usual))
    }

    /// The list with the causes in words.
    pub fn list(&self, usual: &Usual) -> Vec<WorstTick> {
        self.ticks.iter().map(|bad| bad.explain(usual)).collect()
    }
}

/// The phase of a stage with the largest excess over the usual time.
#[derive(Clone, Copy, Debug)]
struct Excess {
    stage: StageId,
    phase: usize,
    took_ns: u64,
    usual_ns: u64,
}

impl Excess {
    const fn ns(&self) -> u64 {
        self.took_ns.saturating_sub(self.usual_ns)
    }

    /// The action of the stage, to follow its name.
    fn action(&self) -> String {
        let took = format!("{} ms", number(Some(ms(self.took_ns))));
        let usual = format!("(usually {})", number(Some(ms(self.usual_ns))));
        match (self.stage, self.phase) {
            (StageId::Sampler, 0) => format!("waited {took} for the controls {usual}"),
            (_, 0) => format!("was busy with an earlier tick for {took} {usual}"),
            (_, 1) => format!("woke {took} after its input was sent {usual}"),
            (_, 2) => format!("computed {took} {usual}"),
            _ => format!("took {took} to send {usual}"),
        }
    }
}

impl Bad {
    /// Whether its forecasts were made without controls.
    const fn lacks_controls(&self) -> bool {
        self.lost == 0 && !self.passage.complete && self.flags & flags::VOID == 0
    }

    /// The phases that took longer than usual, largest excess first.
    fn excesses(&self, usual: &Usual) -> Vec<Excess> {
        let of_stage = |stage: StageId| {
            let each_ns = self.passage.phases(stage).map_or([0; 4], |phases| phases.each_ns());
            let usual_ns = usual.phases_ns[stage.place()];
            (0..4).map(move |phase| Excess {
                stage,
                phase,
                took_ns: each_ns[phase],
                usual_ns: usual_ns[phase],
            })
        };
        let mut all: Vec<Excess> =
            StageId::known().flat_map(of_stage).filter(|excess| excess.ns() >= USUAL_NS).collect();
        all.sort_by_key(|excess| std::cmp::Reverse(excess.ns()));
        all
    }

    fn explain(&self, usual: &Usual) -> WorstTick {
        let name = |stage: StageNumber| StageId::from_number(stage).map_or("unknown", StageId::name);
        let excesses = self.excesses(usual);
        let first = excesses.first().filter(|_| self.lost == 0);
        let (mut stage, mut phase) =
            first.map_or((None, None), |first| (Some(first.stage.name()), Some(Phases::NAMES[first.phase])));
        let blame = |stage: &mut Option<&str>, phase: &mut Option<&str>, number, what| {
            (*stage, *phase) = (Some(name(number)), Some(what));
        };
        let mut cause = if self.lost > 0 {
            let ticks = if self.lost == 1 { "no forecasts".to_owned() } else { self.lost_ticks() };
            match self.restarted {
                Some(number) => {
                    blame(&mut stage, &mut phase, number, "restart");
                    format!("{ticks}: the {} was restarted", name(number))
                }
                None => format!("{ticks}: lost on the way"),
            }
        } else if self.flags & flags::PREDICTED != 0 {
            format!("no detections arrived, its tracks are predicted{}", then(&self.slow(&excesses, usual)))
        } else if self.flags & flags::VOID != 0 {
            "a stage refused the frame or the frame was late: it was passed on empty".to_owned()
        } else if self.lacks_controls() {
            match self.blame {
                Some(Blame::Restarted(number)) => {
                    blame(&mut stage, &mut phase, number, "restart");
                    format!("its controls did not arrive: the {} was restarted", name(number))
                }
                Some(Blame::Behind(number, late_ns)) => {
                    blame(&mut stage, &mut phase, number, "wake-up");
                    let late = number_of_ms(late_ns);
                    format!(
                        "its controls did not arrive: the {} took its next frame {late} late",
                        name(number)
                    )
                }
                Some(Blame::Nobody) => {
                    "its controls arrived too late or were lost; no stage was behind at the next tick"
                        .to_owned()
                }
                None => "its controls did not arrive, and no later tick shows why".to_owned(),
            }
        } else {
            match self.restarted {
                Some(number) => {
                    let slow = then(&self.slow(&excesses, usual));
                    format!("the first tick of the restarted {}{slow}", name(number))
                }
                None => self.slow(&excesses, usual),
            }
        };
        if self.not_learned > 0 {
            let why = Cause::from_number(self.cause).map_or("unknown", Cause::name);
            let (not_learned, agents) = (count(self.not_learned), count(self.agents));
            cause += &format!("; {not_learned} of {agents} forecasts not learned ({why})");
        }
        WorstTick {
            tick: self.seq,
            stamp_ns: self.stamp_ns,
            end_to_end_ms: self.passage.end_to_end_ns.filter(|_| self.lost == 0).map(ms),
            ticks_lost: self.lost,
            agents: self.agents,
            not_learned: self.not_learned,
            stage: stage.map(str::to_owned),
            phase: phase.map(str::to_owned),
            cause,
        }
    }

    fn lost_ticks(&self) -> String {
        format!("{} ticks without forecasts", count(self.lost))
    }

    /// Why the tick was slow, according to its own phases.
    fn slow(&self, excesses: &[Excess], usual: &Usual) -> String {
        let Some(first) = excesses.first() else { return "no phase took longer than usual".to_owned() };
        let total_ns: u64 = excesses.iter().map(Excess::ns).sum();
        let stage_count = StageId::known().filter(|&stage| excesses.iter().any(|e| e.stage == stage)).count();
        let cause = format!("the {} {}", first.stage.name(), first.action());
        // More agents make every stage slower, and so does a busy machine.
        let many = self.agents as f64 > 1.25 * usual.agents && self.agents > 8;
        if many && first.phase == 2 {
            let usual_agents = usual.agents.round() as u64;
            return format!("{cause}: {} agents (usually {})", self.agents, usual_agents);
        }
        if stage_count >= 4 && first.ns() * 2 < total_ns {
            return format!("{stage_count} stages were slower than usual, most of all {cause}");
        }
        let second = excesses.get(1).filter(|second| second.ns() * 3 >= first.ns());
        match second {
            Some(second) if second.stage == first.stage => format!("{cause} and {}", second.action()),
            Some(second) => format!("{cause}, the {} {}", second.stage.name(), second.action()),
            None => cause,
        }
    }
}

fn then(text: &str) -> String {
    format!("; {text}")
}

fn number_of_ms(time_ns: u64) -> String {
    format!("{} ms", number(Some(ms(time_ns))))
}

#[cfg(test)]
mod tests;
