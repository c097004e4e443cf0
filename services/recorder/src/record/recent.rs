//! The last ten seconds of a run.

use std::collections::VecDeque;

use wire::{Heartbeat, StageId};

use crate::passage::Timestamps;
use crate::tick::Tick;

/// Ticks in the window: ten seconds at 12.5 Hz.
pub(crate) const WINDOW_LEN: usize = 125;

/// The newest ticks and heartbeats.
#[derive(Clone, Debug)]
pub(super) struct Recent {
    pub(super) ticks: VecDeque<Tick>,
    pub(super) beats: [Option<Heartbeat>; StageId::PLACES_LEN],
}

impl Default for Recent {
    fn default() -> Self {
        Self { ticks: VecDeque::with_capacity(WINDOW_LEN), beats: [None; StageId::PLACES_LEN] }
    }
}

impl Recent {
    pub(super) fn tick(&mut self, tick: &Tick) {
        if self.ticks.len() == WINDOW_LEN {
            self.ticks.pop_front();
        }
        self.ticks.push_back(*tick);
    }

    pub(super) fn added_stage(&mut self, stage: StageId, times: Timestamps) {
        if let Some(tick) = self.ticks.back_mut() {
            tick.passage.add(stage, times);
        }
    }

    pub(super) fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        if let Some(stage) = StageId::from_number(heartbeat.stage) {
            self.beats[stage.place()] = Some(*heartbeat);
        }
    }
}
