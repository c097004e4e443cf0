//! Frames lost, by stage and cause, from heartbeats and from gaps in the forecasts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Header, Heartbeat, StageId};

use crate::refusals::RefusalCounts;
use crate::report::{Percentiles, RefusedFrames, StageDrops};

/// Counters of one stage over all its incarnations.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Counters {
    incarnation: u32,
    newest: StageDrops,
    /// Counters of earlier incarnations.
    before: StageDrops,
}

impl Counters {
    const fn total(&self) -> StageDrops {
        StageDrops {
            gap: self.newest.gap + self.before.gap,
            unanswered: self.newest.unanswered + self.before.unanswered,
            refused: self.newest.refused + self.before.refused,
            restart: 0,
        }
    }

    fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        if heartbeat.incarnation > self.incarnation {
            self.before = self.total();
            self.newest = StageDrops::default();
            self.incarnation = heartbeat.incarnation;
        }
        if heartbeat.incarnation == self.incarnation {
            // The count decreases if a frame arrives late.
            self.newest.gap = heartbeat.dropped_len.into();
            self.newest.unanswered = heartbeat.unanswered_len.into();
            self.newest.refused = self.newest.refused.max(heartbeat.rejected_len);
        }
    }
}

/// Counts losses of all stages.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Losses {
    stages: [Counters; StageId::PLACES_LEN],
    /// Ticks without forecasts that were lost in the death of a stage, by stage.
    restart: [u64; StageId::PLACES_LEN],
    /// The newest incarnation of each stage through which forecasts have passed.
    passed: [u32; StageId::PLACES_LEN],
    refusals: RefusalCounts,
}

impl Losses {
    /// Adds a stage's own counters. A stale heartbeat of an earlier incarnation is ignored.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        if let Some(stage) = StageId::from_number(heartbeat.stage) {
            self.stages[stage.place()].heartbeat(heartbeat);
        }
        self.refusals.heartbeat(heartbeat);
    }

    /// Refused frames by reader, sender and cause.
    pub fn refusals(&self) -> Vec<RefusedFrames> {
        self.refusals.list()
    }

    /// Counts of links to other boxes, by stage and kind.
    pub fn links(&self) -> BTreeMap<String, BTreeMap<String, u64>> {
        self.refusals.links()
    }

    /// Time from the sensor's stamp to a stage's publication in another system, if the stage measures it.
    pub fn since_stamp_ms(&self, stage: StageId) -> Percentiles {
        self.refusals.since_stamp_ms(stage)
    }

    /// The first stage on a tick's path that was restarted since the previous tick.
    pub fn restarted(&mut self, header: &Header) -> Option<StageId> {
        let mut first = None;
        for hop in header.hops() {
            let Some(stage) = StageId::from_number(hop.stage) else { continue };
            let passed = &mut self.passed[stage.place()];
            if hop.incarnation > *passed {
                *passed = hop.incarnation;
                first = first.or(Some(stage));
            }
        }
        first
    }

    /// Counts ticks whose forecasts never arrived at the recorder. If a stage was restarted in the meantime,
    /// the ticks were lost with the stage.
    pub const fn forecast_gap(&mut self, restarted: Option<StageId>, len: u64) {
        match restarted {
            Some(stage) => self.restart[stage.place()] += len,
            None => self.stages[StageId::Recorder.place()].newest.gap += len,
        }
    }

    /// Counts ticks whose forecasts arrived while the recorder was restarted.
    pub const fn unrecorded(&mut self, len: u64) {
        self.restart[StageId::Recorder.place()] += len;
    }

    /// Counts a frame that the recorder refused.
    pub fn forecast_refused(&mut self) {
        self.stages[StageId::Recorder.place()].newest.refused += 1;
    }

    /// Number of restarts of a stage.
    pub const fn restarts(&self, stage: StageId) -> u32 {
        self.stages[stage.place()].incarnation
    }

    /// Losses of each stage, by its place. `order` is the order in which a tick passes the stages.
    ///
    /// A frame lost in one stage is a gap in all later stages, and counts only in the first. A refused frame
    /// is not a gap, because it is passed on as VOID. The sampler publishes even without controls. A tick is
    /// therefore missing at the recorder only if the tracker has lost its detections or the sampler its
    /// tracks.
    pub fn by_stage(&self, order: &[StageId]) -> [StageDrops; StageId::PLACES_LEN] {
        let mut lost_before = 0;
        let mut own = [StageDrops::default(); StageId::PLACES_LEN];
        let tracks_lost = self.stages[StageId::Tracker.place()].total().gap;
        for stage in order {
            let StageDrops { gap, unanswered, refused, .. } = self.stages[stage.place()].total();
            // Of the sampler's two inputs, the tracks come directly from the tracker.
            let lost_in_tracks = if *stage == StageId::Sampler { tracks_lost } else { lost_before };
            let unanswered = unanswered.saturating_sub(lost_in_tracks);
            let gap_here = gap.saturating_sub(lost_before).max(unanswered);
            own[stage.place()] = StageDrops { gap: gap_here, unanswered, refused, restart: 0 };
            lost_before = lost_before.max(gap);
        }
        let before_recorder = own[StageId::Tracker.place()].gap + own[StageId::Sampler.place()].unanswered;
        let missed = self.stages[StageId::Recorder.place()].total().gap;
        own[StageId::Recorder.place()].gap = missed.saturating_sub(before_recorder);
        // A frame refused as a whole is also a gap, and must count only once.
        for &stage in order {
            let own = &mut own[stage.place()];
            own.gap = own.gap.saturating_sub(self.refusals.tick_count(stage));
        }
        for (own, restart) in own.iter_mut().zip(self.restart) {
            own.restart = restart;
        }
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::{Hop, RefusalCause, Refusals};

    const NONE: StageDrops = StageDrops { gap: 0, unanswered: 0, refused: 0, restart: 0 };

    fn beat(stage: StageId, incarnation: u32, dropped_len: u32, rejected_len: u64) -> Heartbeat {
        Heartbeat { stage: stage.number(), incarnation, dropped_len, rejected_len, ..Heartbeat::zeroed() }
    }

    fn gap(losses: &mut Losses, header: &Header, len: u64) {
        let restarted = losses.restarted(header);
        losses.forecast_gap(restarted, len);
    }

    fn of(losses: &Losses, stage: StageId) -> StageDrops {
        losses.by_stage(&StageId::ALL)[stage.place()]
    }

    #[test]
    fn a_frame_counts_where_it_was_lost_first() {
        let mut losses = Losses::default();
        losses.heartbeat(&beat(StageId::Tracker, 0, 2, 1));
        losses.heartbeat(&beat(StageId::Localiser, 0, 2, 0));
        losses.heartbeat(&beat(StageId::Extractor, 0, 4, 0));
        losses.heartbeat(&beat(StageId::Sampler, 0, 4, 0));
        gap(&mut losses, &Header::new(1, 9, 0), 3);
        assert_eq!(of(&losses, StageId::Tracker), StageDrops { gap: 2, refused: 1, ..NONE });
        assert_eq!(of(&losses, StageId::Localiser), StageDrops::default());
        assert_eq!(of(&losses, StageId::Extractor), StageDrops { gap: 2, ..NONE });
        assert_eq!(of(&losses, StageId::Sampler), StageDrops::default());
        assert_eq!(of(&losses, StageId::Recorder), StageDrops { gap: 1, ..NONE });
    }

    /// The sampler answers a tick without controls, but cannot answer a tick without tracks.
    #[test]
    fn what_the_sampler_loses_of_the_tracks_is_told_apart() {
        let mut losses = Losses::default();
        losses.heartbeat(&beat(StageId::Tracker, 0, 2, 0));
        losses.heartbeat(&beat(StageId::Decoder, 0, 9, 0));
        let sampler = beat(StageId::Sampler, 0, 9, 0);
        losses.heartbeat(&Heartbeat { unanswered_len: 5, ..sampler });
        gap(&mut losses, &Header::new(1, 9, 0), 6);
        assert_eq!(of(&losses, StageId::Sampler), StageDrops { gap: 3, unanswered: 3, ..NONE });
        assert_eq!(of(&losses, StageId::Recorder), StageDrops { gap: 1, ..NONE });
    }

    #[test]
    fn a_tick_that_was_refused_whole_counts_once() {
        let mut losses = Losses::default();
        let mut heartbeat = beat(StageId::Tracker, 0, 3, 2);
        Refusals::count(&mut heartbeat.refusals, StageId::Source.number(), RefusalCause::CheckValue, 2);
        losses.heartbeat(&heartbeat);
        losses.heartbeat(&beat(StageId::Localiser, 0, 3, 0));
        gap(&mut losses, &Header::new(1, 9, 0), 3);
        assert_eq!(of(&losses, StageId::Tracker), StageDrops { gap: 1, refused: 2, ..NONE });
        for stage in [StageId::Localiser, StageId::Recorder] {
            assert_eq!(of(&losses, stage), StageDrops::default());
        }
    }

    #[test]
    fn losses_add_up_over_restarts() {
        let mut losses = Losses::default();
        losses.heartbeat(&beat(StageId::Encoder, 0, 4, 0));
        losses.heartbeat(&beat(StageId::Encoder, 1, 1, 0));
        losses.heartbeat(&beat(StageId::Encoder, 0, 9, 0));
        assert_eq!(of(&losses, StageId::Encoder), StageDrops { gap: 5, ..NONE });
        assert_eq!(losses.restarts(StageId::Encoder), 1);
    }

    #[test]
    fn ticks_that_died_with_a_stage_are_put_down_to_it() {
        let header = |incarnation| {
            let mut header = Header::new(1, 9, 0);
            header.push_hop(Hop { stage: StageId::Tracker.number(), incarnation, ..Hop::zeroed() });
            header
        };
        let mut losses = Losses::default();
        gap(&mut losses, &header(0), 0);
        gap(&mut losses, &header(1), 3);
        gap(&mut losses, &header(1), 1);
        assert_eq!(of(&losses, StageId::Tracker), StageDrops { restart: 3, ..NONE });
        assert_eq!(of(&losses, StageId::Recorder), StageDrops { gap: 1, ..NONE });
    }

    #[test]
    fn unknown_stages_are_ignored() {
        let mut losses = Losses::default();
        losses.heartbeat(&Heartbeat { stage: 99, dropped_len: 7, ..Heartbeat::zeroed() });
        assert_eq!(losses.by_stage(&StageId::ALL), [StageDrops::default(); StageId::PLACES_LEN]);
    }
}
