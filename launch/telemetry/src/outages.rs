//! The cost of each death of a stage: ticks without forecasts, without learned forecasts, or without
//! detections.

use std::collections::BTreeMap;

use recorder::{Outage, Replacement, ReplacementOutcome, Supervision, Tick};
use rustix::process::Pid;
use wire::{Header, StageId, flags};

use supervisor::Origin;
use supervisor::Replaced;

/// Maximum number of listed outages; further ones are only counted.
const LISTED_MAX: usize = 2048;

/// The outages of a run, computed from its forecasts and the launcher's restarts.
#[derive(Debug, Default)]
pub struct Outages {
    record: Supervision,
    /// Outages after which forecasts are not learned again yet, with their stages.
    open: Vec<(Place, StageId)>,
    /// Index of the replacement whose new process has taken over but is not linked yet.
    trial: Option<usize>,
    /// The newest tick with forecasts.
    newest: Option<u64>,
}

/// Where an outage is listed.
#[derive(Clone, Copy, Debug)]
enum Place {
    Outage(usize),
    Replacement(usize),
}

impl Outages {
    /// Records that a stage has died and will be restarted with this incarnation.
    pub fn begin(&mut self, stage: StageId, incarnation: u32, cause: &str) {
        let list = &mut self.record.outages;
        if list.len() == LISTED_MAX {
            self.record.outages_unlisted += 1;
            return;
        }
        let (name, tick) = (stage.name().to_owned(), self.newest.unwrap_or(0));
        list.push(Outage { stage: name, incarnation, cause: cause.to_owned(), tick, ..Outage::default() });
        // Forecasts do not depend on the recorder.
        if stage == StageId::Recorder {
            list.last_mut().expect("just pushed").ticks_to_learned = Some(0);
        } else {
            self.open.push((Place::Outage(list.len() - 1), stage));
        }
    }

    /// Records that the detector was not ready before the run had begun.
    pub const fn not_ready(&mut self) {
        self.record.early_starts = self.record.early_starts.saturating_add(1);
    }

    /// Records that a dead stage continues with its spare.
    pub fn promoted(&mut self, stage: StageId) {
        let of_stage = |outage: &&mut Outage| outage.stage == stage.name();
        if let Some(outage) = self.record.outages.iter_mut().rev().find(of_stage) {
            outage.by_spare = true;
        }
    }

    /// Records that a stage's process has ended for its replacement.
    pub fn handed_over(&mut self, replaced: &Replaced) {
        self.trial = self.list(replaced);
        if let Some(index) = self.trial.filter(|_| replaced.stage != StageId::Recorder) {
            self.open.push((Place::Replacement(index), replaced.stage));
        }
    }

    /// Records the outcome of a replacement.
    pub fn tried(&mut self, replaced: &Replaced) {
        let index = match replaced.outcome {
            ReplacementOutcome::NotUsed => self.list(replaced),
            ReplacementOutcome::Replaced | ReplacementOutcome::RolledBack => self.trial.take(),
        };
        if let Some(index) = index {
            let listed = &mut self.record.replacements[index];
            listed.outcome = replaced.outcome;
            listed.outage.cause.clone_from(&replaced.cause);
            if listed.outage.incarnation != replaced.incarnation {
                // Forecasts of the failed process do not end the outage.
                (listed.outage.incarnation, listed.outage.ticks_to_learned) = (replaced.incarnation, None);
                let is_open = self
                    .open
                    .iter()
                    .any(|(place, _)| matches!(place, Place::Replacement(of) if *of == index));
                if !is_open && replaced.stage != StageId::Recorder {
                    self.open.push((Place::Replacement(index), replaced.stage));
                }
            }
        }
    }

    /// Lists a replacement, and returns its index.
    fn list(&mut self, replaced: &Replaced) -> Option<usize> {
        let list = &mut self.record.replacements;
        if list.len() == LISTED_MAX {
            self.record.replacements_unlisted += 1;
            return None;
        }
        let ms = |time: std::time::Duration| (time.as_secs_f64() * 1e4).round() / 1e1;
        // Forecasts depend neither on the recorder nor on a rejected process.
        let is_awaited =
            replaced.stage != StageId::Recorder && replaced.outcome != ReplacementOutcome::NotUsed;
        let outage = Outage {
            stage: replaced.stage.name().to_owned(),
            incarnation: replaced.incarnation,
            cause: replaced.cause.clone(),
            tick: self.newest.unwrap_or(0),
            ticks_to_learned: (!is_awaited).then_some(0),
            ..Outage::default()
        };
        list.push(Replacement {
            command: replaced.command.clone(),
            outcome: replaced.outcome,
            warm_up_ms: replaced.warm_up.map(ms),
            hand_over_ms: replaced.hand_over.map(ms),
            outage,
        });
        Some(list.len() - 1)
    }

    /// Records that a stage is given up.
    pub fn give_up(&mut self, stage: StageId, why: String) {
        self.record.given_up.insert(stage.name().to_owned(), why);
    }

    /// Records that a stage got no CPU time.
    pub fn starved(&mut self, stage: StageId) {
        *self.record.starved.entry(stage.name().to_owned()).or_default() += 1;
    }

    /// Records the numbers of discarded lines so far. Returns the origins whose first lines were discarded.
    pub fn lost_lines(&mut self, lost: BTreeMap<Origin, u64>) -> Vec<Origin> {
        let name = |origin: Origin| origin.map_or("launcher", StageId::name).to_owned();
        let mut is_new = |(origin, lines)| self.record.lost_lines.insert(name(origin), lines).is_none();
        lost.into_iter().filter(|&entry| is_new(entry)).map(|(origin, _)| origin).collect()
    }

    /// Records a process that could not be killed.
    pub fn not_ended(&mut self, stage: StageId, pid: Pid) {
        let pid = pid.as_raw_nonzero().get().unsigned_abs();
        self.record.not_ended.insert(stage.name().to_owned(), pid);
    }

    /// Records a setting of pipeline.toml that the system refused.
    pub fn note(&mut self, note: String) {
        self.record.notes.push(note);
    }

    /// Records a tick.
    pub fn tick(&mut self, header: &Header, tick: &Tick) {
        if self.newest.is_some_and(|newest| header.seq <= newest) {
            return;
        }
        let lost = self.newest.map_or(0, |newest| header.seq - newest - 1);
        self.newest = Some(header.seq);
        if self.open.is_empty() {
            return;
        }
        let (predicted, void) = (header.has(flags::PREDICTED), header.has(flags::VOID));
        let all_learned = !void && !tick.is_degraded;
        let Supervision { outages, replacements, .. } = &mut self.record;
        self.open.retain(|&(place, stage)| {
            let outage = match place {
                Place::Outage(index) => &mut outages[index],
                Place::Replacement(index) => &mut replacements[index].outage,
            };
            outage.ticks_lost += lost;
            outage.ticks_predicted += u64::from(predicted);
            outage.ticks_not_learned += u64::from(!all_learned);
            let is_back = header.hop(stage).is_some_and(|hop| hop.incarnation >= outage.incarnation);
            let over = is_back && all_learned && tick.is_served && !predicted;
            if over {
                outage.ticks_to_learned = Some(header.seq - outage.tick);
            }
            !over
        });
    }

    /// Returns the stages that were given up, with the reasons.
    pub const fn given_up(&self) -> &BTreeMap<String, String> {
        &self.record.given_up
    }

    /// Returns the record so far.
    pub const fn record(&self) -> &Supervision {
        &self.record
    }

    /// Returns the complete record for the report.
    pub fn into_record(self, ended_by: Option<String>) -> Supervision {
        Supervision { ended_by, ..self.record }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::{Cause, Forecast, Hop, Quality};

    fn frame(seq: u64, decoder: Option<u32>) -> (Header, Forecast) {
        let mut header = Header::new(1, seq, 0);
        if let Some(incarnation) = decoder {
            header.push_hop(Hop { stage: StageId::Decoder.number(), incarnation, ..Hop::zeroed() });
        }
        let learned = decoder.is_some();
        let (quality, cause) =
            if learned { (Quality::Learned, Cause::None) } else { (Quality::Held, Cause::Late) };
        (header, Forecast { quality: quality as u32, cause: cause as u32, ..Forecast::zeroed() })
    }

    fn tick(outages: &mut Outages, seq: u64, decoder: Option<u32>) {
        let (header, forecast) = frame(seq, decoder);
        outages.tick(&header, &Tick::alone(&header, &[forecast]));
    }

    #[test]
    fn a_replacement_costs_until_the_incarnation_that_stays_is_learned_from() {
        let mut outages = Outages::default();
        let mut replaced = Replaced {
            stage: StageId::Decoder,
            command: vec!["./mine".to_owned()],
            outcome: ReplacementOutcome::Replaced,
            incarnation: 1,
            cause: String::new(),
            warm_up: None,
            hand_over: None,
        };
        tick(&mut outages, 10, Some(0));
        outages.handed_over(&replaced);
        tick(&mut outages, 11, None);
        replaced = Replaced { outcome: ReplacementOutcome::RolledBack, incarnation: 2, ..replaced };
        outages.tried(&replaced);
        tick(&mut outages, 12, None);
        tick(&mut outages, 14, Some(2));
        outages.tried(&Replaced {
            outcome: ReplacementOutcome::NotUsed,
            cause: "ended".to_owned(),
            ..replaced
        });
        let record = outages.into_record(None);
        let rolled_back = &record.replacements[0];
        assert_eq!(rolled_back.outcome, ReplacementOutcome::RolledBack);
        let outage = &rolled_back.outage;
        assert_eq!((outage.tick, outage.ticks_lost, outage.ticks_not_learned), (10, 1, 2));
        assert_eq!(outage.ticks_to_learned, Some(4));
        let not_used = &record.replacements[1].outage;
        assert_eq!(
            (not_used.tick, not_used.cause.as_str(), not_used.ticks_to_learned),
            (14, "ended", Some(0))
        );
        assert!(record.outages.is_empty(), "a replacement is no death");
    }

    #[test]
    fn an_outage_lasts_until_the_new_incarnation_is_learned_from() {
        let mut outages = Outages::default();
        tick(&mut outages, 10, Some(0));
        outages.begin(StageId::Decoder, 1, "was killed");
        tick(&mut outages, 11, Some(0));
        tick(&mut outages, 12, None);
        tick(&mut outages, 14, None);
        tick(&mut outages, 15, Some(1));
        tick(&mut outages, 20, None);
        let record = outages.into_record(None);
        let outage = &record.outages[0];
        assert_eq!((outage.tick, outage.ticks_lost, outage.ticks_not_learned), (10, 1, 2));
        assert_eq!(outage.ticks_to_learned, Some(5));
    }

    #[test]
    fn controls_of_which_constant_velocity_knows_better_end_an_outage_and_young_agents_do_not() {
        let mut outages = Outages::default();
        outages.begin(StageId::Decoder, 1, "was killed");
        let mut tick = |seq, cause| {
            let (header, forecast) = frame(seq, Some(1));
            let forecast = Forecast { quality: Quality::Kinematic as u32, cause: cause as u32, ..forecast };
            outages.tick(&header, &Tick::alone(&header, &[forecast]));
        };
        tick(1, Cause::Young);
        tick(2, Cause::Outdone);
        tick(3, Cause::Late);
        assert_eq!(outages.into_record(None).outages[0].ticks_to_learned, Some(2));
    }
}
