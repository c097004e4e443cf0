//! What each death of a stage cost: ticks without forecasts, not learned, or without detections.

use std::collections::BTreeMap;

use recorder::{Outage, Supervision};
use wire::{Cause, Forecast, Header, Quality, StageId, flags};

/// Most outages that are listed; further ones are counted.
const LISTED_MAX: usize = 256;

/// The outages of a run, from its forecasts and the launcher's restarts.
#[derive(Debug, Default)]
pub struct Outages {
    record: Supervision,
    /// Indices of those after which the forecasts are not learned again yet, with the stages.
    open: Vec<(usize, StageId)>,
    /// The newest tick with forecasts.
    newest: Option<u64>,
}

impl Outages {
    /// A stage has died and is to be started again as that incarnation.
    pub fn begin(&mut self, stage: StageId, incarnation: u32, cause: &str) {
        let list = &mut self.record.outages;
        if list.len() == LISTED_MAX {
            self.record.outages_unlisted += 1;
            return;
        }
        let (name, tick) = (stage.name().to_owned(), self.newest.unwrap_or(0));
        list.push(Outage { stage: name, incarnation, cause: cause.to_owned(), tick, ..Outage::default() });
        // Nothing waits for the recorder.
        if stage == StageId::Recorder {
            list.last_mut().expect("just pushed").ticks_to_learned = Some(0);
        } else {
            self.open.push((list.len() - 1, stage));
        }
    }

    /// A stage is given up for good.
    pub fn give_up(&mut self, stage: StageId, why: String) {
        self.record.given_up.insert(stage.name().to_owned(), why);
    }

    /// A stage got no CPU.
    pub fn starved(&mut self, stage: StageId) {
        *self.record.starved.entry(stage.name().to_owned()).or_default() += 1;
    }

    /// A setting of pipeline.toml is not allowed.
    pub fn note(&mut self, note: String) {
        self.record.notes.push(note);
    }

    /// The forecasts of a tick have come.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) {
        if !header.is_tick() || self.newest.is_some_and(|newest| header.seq <= newest) {
            return;
        }
        let lost = self.newest.map_or(0, |newest| header.seq - newest - 1);
        self.newest = Some(header.seq);
        if self.open.is_empty() {
            return;
        }
        let (predicted, void) = (header.has(flags::PREDICTED), header.has(flags::VOID));
        let excused = [Cause::Young, Cause::Outdone].map(|cause| cause as u32);
        let is_learned = |forecast: &Forecast| forecast.quality == Quality::Learned as u32;
        let all_learned = !void && forecasts.iter().all(|f| is_learned(f) || excused.contains(&f.cause));
        let some_learned = forecasts.is_empty() || forecasts.iter().any(is_learned);
        let list = &mut self.record.outages;
        self.open.retain(|&(index, stage)| {
            let outage = &mut list[index];
            outage.ticks_lost += lost;
            outage.ticks_predicted += u64::from(predicted);
            outage.ticks_not_learned += u64::from(!all_learned);
            let is_back = header.hop(stage).is_some_and(|hop| hop.incarnation >= outage.incarnation);
            let over = is_back && all_learned && some_learned && !predicted;
            if over {
                outage.ticks_to_learned = Some(header.seq - outage.tick);
            }
            !over
        });
    }

    /// Whether a stage was given up.
    pub const fn given_up(&self) -> &BTreeMap<String, String> {
        &self.record.given_up
    }

    /// All of it, for the report.
    pub fn into_record(self, ended_by: Option<String>) -> Supervision {
        Supervision { ended_by, ..self.record }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::Hop;

    fn frame(seq: u64, decoder: Option<u32>) -> (Header, Forecast) {
        let mut header = Header::new(1, seq, 0);
        if let Some(incarnation) = decoder {
            header.push_hop(Hop { stage: StageId::Decoder as u32, incarnation, ..Hop::zeroed() });
        }
        let learned = decoder.is_some();
        let (quality, cause) =
            if learned { (Quality::Learned, Cause::None) } else { (Quality::Held, Cause::Late) };
        (header, Forecast { quality: quality as u32, cause: cause as u32, ..Forecast::zeroed() })
    }

    #[test]
    fn an_outage_lasts_until_the_new_incarnation_is_learned_from() {
        let mut outages = Outages::default();
        let tick = |outages: &mut Outages, seq, decoder| {
            let (header, forecast) = frame(seq, decoder);
            outages.forecasts(&header, &[forecast]);
        };
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
}
