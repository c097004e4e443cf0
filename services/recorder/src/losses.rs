//! Frames lost, by stage and cause, from heartbeats and from gaps in the forecasts.

use wire::{Heartbeat, StageId};

use crate::passage::{STAGES_LEN, place};
use crate::report::StageDrops;

/// Counters of one stage over all its incarnations.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    incarnation: u32,
    newest: StageDrops,
    /// Of the incarnations before.
    before: StageDrops,
}

impl Counters {
    const fn total(&self) -> StageDrops {
        StageDrops {
            gap: self.newest.gap + self.before.gap,
            refused: self.newest.refused + self.before.refused,
        }
    }

    fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        if heartbeat.incarnation > self.incarnation {
            self.before = self.total();
            self.newest = StageDrops::default();
            self.incarnation = heartbeat.incarnation;
        }
        if heartbeat.incarnation == self.incarnation {
            self.newest.gap = self.newest.gap.max(heartbeat.dropped_len);
            self.newest.refused = self.newest.refused.max(heartbeat.rejected_len);
        }
    }
}

/// Counts losses of all stages.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Losses {
    stages: [Counters; STAGES_LEN],
}

impl Losses {
    /// Takes a stage's own counters. A heartbeat of an earlier incarnation is stale and ignored.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        if let Some(stage) = StageId::from_number(heartbeat.stage) {
            self.stages[place(stage)].heartbeat(heartbeat);
        }
    }

    /// Counts frames of forecasts that never arrived at the recorder.
    pub fn forecast_gap(&mut self, len: u64) {
        self.stages[place(StageId::Recorder)].newest.gap += len;
    }

    /// Counts a frame that the recorder refused.
    pub fn forecast_refused(&mut self) {
        self.stages[place(StageId::Recorder)].newest.refused += 1;
    }

    /// Number of restarts of a stage.
    pub const fn restarts(&self, stage: StageId) -> u32 {
        self.stages[place(stage)].incarnation
    }

    /// Losses of each stage, in the order of [`StageId::ALL`].
    ///
    /// A frame lost in one stage is a gap in all later ones; it counts where it was lost first. A refused
    /// frame is no gap: it is passed on as VOID. The sampler publishes also without controls, so a tick is
    /// missing at the recorder only if the tracker or the sampler lost it.
    pub fn by_stage(&self) -> [StageDrops; STAGES_LEN] {
        let mut lost_before = 0;
        let mut own = self.stages.map(|counters| {
            let StageDrops { gap, refused } = counters.total();
            let own = StageDrops { gap: gap.saturating_sub(lost_before), refused };
            lost_before = lost_before.max(gap);
            own
        });
        let before_recorder = own[place(StageId::Tracker)].gap + own[place(StageId::Sampler)].gap;
        let missed = self.stages[place(StageId::Recorder)].total().gap;
        own[place(StageId::Recorder)].gap = missed.saturating_sub(before_recorder);
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn beat(stage: StageId, incarnation: u32, dropped_len: u64, rejected_len: u64) -> Heartbeat {
        Heartbeat { stage: stage as u32, incarnation, dropped_len, rejected_len, ..Heartbeat::zeroed() }
    }

    fn of(losses: &Losses, stage: StageId) -> StageDrops {
        losses.by_stage()[place(stage)]
    }

    #[test]
    fn a_frame_counts_where_it_was_lost_first() {
        let mut losses = Losses::default();
        losses.heartbeat(&beat(StageId::Tracker, 0, 2, 1));
        losses.heartbeat(&beat(StageId::Localiser, 0, 2, 0));
        losses.heartbeat(&beat(StageId::Extractor, 0, 4, 0));
        losses.heartbeat(&beat(StageId::Sampler, 0, 4, 0));
        losses.forecast_gap(3);
        assert_eq!(of(&losses, StageId::Tracker), StageDrops { gap: 2, refused: 1 });
        assert_eq!(of(&losses, StageId::Localiser), StageDrops::default());
        assert_eq!(of(&losses, StageId::Extractor), StageDrops { gap: 2, refused: 0 });
        assert_eq!(of(&losses, StageId::Sampler), StageDrops::default());
        assert_eq!(of(&losses, StageId::Recorder), StageDrops { gap: 1, refused: 0 });
    }

    #[test]
    fn losses_add_up_over_restarts() {
        let mut losses = Losses::default();
        losses.heartbeat(&beat(StageId::Encoder, 0, 4, 0));
        losses.heartbeat(&beat(StageId::Encoder, 1, 1, 0));
        losses.heartbeat(&beat(StageId::Encoder, 0, 9, 0));
        assert_eq!(of(&losses, StageId::Encoder), StageDrops { gap: 5, refused: 0 });
        assert_eq!(losses.restarts(StageId::Encoder), 1);
    }

    #[test]
    fn unknown_stages_are_ignored() {
        let mut losses = Losses::default();
        losses.heartbeat(&Heartbeat { stage: 99, dropped_len: 7, ..Heartbeat::zeroed() });
        assert_eq!(losses.by_stage(), [StageDrops::default(); STAGES_LEN]);
    }
}
