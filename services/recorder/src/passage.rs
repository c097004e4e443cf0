//! The passage of one tick through the pipeline, from the hops of its header.
//!
//! Every stage stamps four times: it received its input, started its computation, finished it, and sent its
//! output. Starting at the time when the previous stage sent its output, four phases follow without gap or
//! overlap:
//!
//! * *waiting*: the stage was busy with an earlier tick, or had one input and waited for another (the sampler
//!   for controls, until its deadline);
//! * *wake-up*: transport, scheduling and the check of the frame;
//! * *compute*;
//! * *publish*: writing the header and sending the frame.
//!
//! The phases of all stages therefore add up to the latency from release to forecast. All phases except
//! compute are *overhead*.

use serde::{Deserialize, Serialize};
use wire::{Header, Hop, StageId};

/// The times at which one stage moved to the next phase of a tick, `CLOCK_MONOTONIC`. The times increase in
/// this order. The exception is `taken_ns`: a stage with two inputs has it from the first input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Timestamps {
    /// The previous stage had sent the input.
    pub ready_ns: u64,
    /// The input was available, and the stage had sent the previous tick.
    pub free_ns: u64,
    /// The stage had taken the input from its queue.
    pub taken_ns: u64,
    /// The computation began.
    pub started_ns: u64,
    /// The computation ended.
    pub finished_ns: u64,
    /// The output was sent.
    pub sent_ns: u64,
}

impl Timestamps {
    /// The timestamps of `hop`, whose input was sent at `ready_ns` and whose stage was free from `free_ns`.
    fn of(hop: &Hop, ready_ns: u64, free_ns: u64) -> Self {
        // A stage with two inputs may receive one before the other is sent. The remaining time is wake-up.
        let taken_ns = if hop.received_ns < ready_ns { hop.started_ns } else { hop.received_ns };
        let free_ns = ready_ns.max(free_ns.min(taken_ns));
        let Hop { started_ns, finished_ns, sent_ns, .. } = *hop;
        Self { ready_ns, free_ns, taken_ns, started_ns, finished_ns, sent_ns }
    }
}

/// Phases of one tick in one stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Phases {
    /// Time in which the input was available, but the stage was busy or waited for other input.
    pub waiting_ns: u64,
    /// From the sending of the input to its receipt by a free stage.
    pub wake_up_ns: u64,
    /// From the start to the end of the computation.
    pub compute_ns: u64,
    /// From the end of the computation to the sending of the output.
    pub publish_ns: u64,
}

impl Phases {
    /// The names, in the order of [`Phases::each_ns`].
    pub const NAMES: [&str; 4] = ["waiting", "wake-up", "compute", "publish"];

    /// Waiting, wake-up, compute and publish.
    #[must_use]
    pub const fn each_ns(&self) -> [u64; 4] {
        [self.waiting_ns, self.wake_up_ns, self.compute_ns, self.publish_ns]
    }
}

impl From<Timestamps> for Phases {
    fn from(times: Timestamps) -> Self {
        let Timestamps { ready_ns, free_ns, taken_ns, started_ns, finished_ns, sent_ns } = times;
        Self {
            waiting_ns: (free_ns - ready_ns) + started_ns.saturating_sub(taken_ns),
            wake_up_ns: taken_ns.saturating_sub(free_ns),
            compute_ns: finished_ns.saturating_sub(started_ns),
            publish_ns: sent_ns.saturating_sub(finished_ns),
        }
    }
}

/// Phases of one tick in all stages, from release to forecast.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Passage {
    stages: [Option<Timestamps>; StageId::PLACES_LEN],
    /// Time from release at the source to the sending of the forecasts; `None` if the tick did not pass the
    /// sampler.
    pub end_to_end_ns: Option<u64>,
    /// Whether the tick passed every stage from the tracker to the sampler. Its forecasts then come from its
    /// own controls. A sensor that replaces the source does not have to stamp a hop.
    pub complete: bool,
}

impl Passage {
    /// Adds the phases of a stage outside the tick's path.
    pub(crate) fn add(&mut self, stage: StageId, times: Timestamps) {
        self.stages[stage.place()] = Some(times);
    }

    /// The timestamps in one stage, if the tick passed it.
    #[must_use]
    pub const fn times(&self, stage: StageId) -> Option<Timestamps> {
        self.stages[stage.place()]
    }

    /// The phases in one stage, if the tick passed it.
    #[must_use]
    pub fn phases(&self, stage: StageId) -> Option<Phases> {
        self.times(stage).map(Phases::from)
    }

    /// Compute of all stages. A tick passes them in sequence, so all of it is on the critical path.
    #[must_use]
    pub fn compute_ns(&self) -> u64 {
        self.stages.iter().flatten().map(|times| Phases::from(*times).compute_ns).sum()
    }

    /// End-to-end latency minus compute. `None` if the sampler's deadline passed, because that time is not a
    /// cost of transport.
    #[must_use]
    pub fn overhead_ns(&self) -> Option<u64> {
        self.end_to_end_ns
            .filter(|_| self.complete)
            .map(|total_ns| total_ns.saturating_sub(self.compute_ns()))
    }
}

/// Reads passages tick by tick, because the time at which a stage became free is known from the previous
/// tick.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    free_ns: [u64; StageId::PLACES_LEN],
}

impl Timeline {
    /// The passage of a tick from its header. Hops of unknown stages are ignored.
    pub fn pass(&mut self, header: &Header) -> Passage {
        let mut passage = Passage::default();
        let mut ready_ns = header.released_ns;
        for hop in header.hops() {
            if let Some(stage) = StageId::from_number(hop.stage) {
                let free_ns = std::mem::replace(&mut self.free_ns[stage.place()], hop.sent_ns);
                passage.stages[stage.place()] = Some(Timestamps::of(hop, ready_ns, free_ns));
            }
            ready_ns = hop.sent_ns;
        }
        passage.end_to_end_ns =
            header.hop(StageId::Sampler).map(|hop| hop.sent_ns.saturating_sub(header.released_ns));
        passage.complete = StageId::ALL[StageId::Tracker.place()..StageId::Recorder.place()]
            .iter()
            .all(|&stage| passage.stages[stage.place()].is_some());
        passage
    }

    /// The stage that sent a frame outside the tick's path, and its times; `None` if the stage has not stamped
    /// its passage.
    pub fn newest_times(&mut self, header: &Header) -> Option<(StageId, Timestamps)> {
        let stage = StageId::from_number(header.sender)?;
        let index = header.hops().iter().rposition(|hop| hop.stage == header.sender)?;
        let hop = &header.hops()[index];
        let ready_ns =
            index.checked_sub(1).map_or(header.released_ns, |before| header.hops()[before].sent_ns);
        let free_ns = std::mem::replace(&mut self.free_ns[stage.place()], hop.sent_ns);
        Some((stage, Timestamps::of(hop, ready_ns, free_ns)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hop(stage: StageId, times_ns: [u64; 4]) -> Hop {
        let [received_ns, started_ns, finished_ns, sent_ns] = times_ns;
        Hop { stage: stage.number(), incarnation: 0, received_ns, started_ns, finished_ns, sent_ns }
    }

    fn header(released_ns: u64, hops: &[Hop]) -> Header {
        let mut header = Header { released_ns, ..Header::new(1, 0, 0) };
        hops.iter().for_each(|&h| header.push_hop(h));
        header
    }

    #[test]
    fn phases_add_up_to_the_end_to_end_latency() {
        let hops = [
            hop(StageId::Source, [100, 100, 130, 140]),
            hop(StageId::Tracker, [160, 165, 265, 270]),
            hop(StageId::Sampler, [200, 300, 350, 360]),
        ];
        let passage = Timeline::default().pass(&header(100, &hops));
        let total: u64 = StageId::ALL
            .iter()
            .filter_map(|&stage| passage.phases(stage))
            .map(|p| p.waiting_ns + p.wake_up_ns + p.compute_ns + p.publish_ns)
            .sum();
        assert_eq!(passage.end_to_end_ns, Some(260));
        assert_eq!(total, 260);
        assert_eq!(passage.compute_ns(), 30 + 100 + 50);
        assert_eq!(
            passage.phases(StageId::Tracker),
            Some(Phases { waiting_ns: 5, wake_up_ns: 20, compute_ns: 100, publish_ns: 5 })
        );
        assert_eq!(passage.phases(StageId::Decoder), None);
    }

    #[test]
    fn a_tick_without_controls_has_no_overhead() {
        let hops = [hop(StageId::Source, [0, 0, 1, 2]), hop(StageId::Sampler, [3, 80, 81, 82])];
        let passage = Timeline::default().pass(&header(0, &hops));
        assert!(!passage.complete);
        assert_eq!(passage.overhead_ns(), None);
    }

    #[test]
    fn overhead_is_end_to_end_latency_less_compute() {
        let hops: Vec<Hop> = StageId::ALL[..7]
            .iter()
            .zip(0..)
            .map(|(&stage, i)| hop(stage, [10 * i + 1, 10 * i + 2, 10 * i + 8, 10 * i + 10]))
            .collect();
        let passage = Timeline::default().pass(&header(0, &hops));
        assert_eq!((passage.end_to_end_ns, passage.overhead_ns()), (Some(70), Some(70 - 7 * 6)));
    }

    #[test]
    fn a_frame_that_finds_its_stage_busy_waits() {
        let mut timeline = Timeline::default();
        timeline
            .pass(&header(0, &[hop(StageId::Source, [0, 0, 0, 0]), hop(StageId::Tracker, [5, 5, 90, 100])]));
        let second = [hop(StageId::Source, [40, 40, 40, 40]), hop(StageId::Tracker, [103, 104, 110, 111])];
        let passage = timeline.pass(&header(40, &second));
        assert_eq!(
            passage.phases(StageId::Tracker),
            Some(Phases { waiting_ns: 60 + 1, wake_up_ns: 3, compute_ns: 6, publish_ns: 1 })
        );
    }

    #[test]
    fn clocks_that_run_backwards_give_zeros() {
        let hops = [hop(StageId::Source, [9, 8, 7, 6]), hop(StageId::Sampler, [5, 4, 3, 2])];
        let passage = Timeline::default().pass(&header(10, &hops));
        assert_eq!((passage.end_to_end_ns, passage.compute_ns()), (Some(0), 0));
    }
}
