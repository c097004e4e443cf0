//! The counts of a stage and the heartbeat that publishes them. Nothing here touches the transport.

use std::rc::Rc;

use wire::{Header, Heartbeat, LinkCount, REFUSALS_MAX, Refusals, Rejected, StageId};

use crate::limits::HEARTBEAT;
use crate::subscriber::Input;

/// The inputs of a stage: first the inputs on a tick's path, then the inputs that later stages write.
#[derive(Debug, Default)]
pub(crate) struct Inputs {
    all: Vec<Rc<dyn Input>>,
    on_path_count: usize,
}

impl Inputs {
    /// Adds an input on a tick's path.
    pub fn add(&mut self, input: Rc<dyn Input>) {
        self.all.insert(self.on_path_count, input);
        self.on_path_count += 1;
    }

    /// Adds an input that a later stage writes. A tick that is missing in it was counted at an earlier stage.
    pub fn add_feedback(&mut self, input: Rc<dyn Input>) {
        self.all.push(input);
    }

    /// Skips the ticks up to this one: another process has answered them.
    pub fn resume_after(&self, seq: u64) {
        self.on_path().for_each(|input| input.resume_after(seq));
    }

    fn on_path(&self) -> impl Iterator<Item = &Rc<dyn Input>> {
        self.all.iter().take(self.on_path_count)
    }
}

/// The counts of a stage.
#[derive(Debug)]
pub(crate) struct Tally {
    id: StageId,
    incarnation: u32,
    /// Whether a frame has been sent, or there is no output.
    pub has_passed: bool,
    beat: u64,
    next_beat_ns: u64,
    seq: u64,
    frames_len: u64,
    rejected_len: u64,
    refusals: [Refusals; REFUSALS_MAX],
    link: [Refusals; REFUSALS_MAX],
}

impl Tally {
    pub fn new(id: StageId, incarnation: u32) -> Self {
        Self {
            id,
            incarnation,
            has_passed: true,
            beat: 0,
            next_beat_ns: 0,
            seq: 0,
            frames_len: 0,
            rejected_len: 0,
            refusals: [Refusals::default(); REFUSALS_MAX],
            link: [Refusals::default(); REFUSALS_MAX],
        }
    }

    /// Counts a tick as finished.
    pub fn finish(&mut self, seq: u64) {
        self.seq = seq;
        self.frames_len += 1;
    }

    /// Notes a tick that was lost before it reached the stage.
    pub fn skip(&mut self, seq: u64) {
        self.seq = seq;
    }

    /// Counts a refused frame.
    pub fn refuse(&mut self, header: &Header, why: &Rejected) {
        self.seq = header.seq;
        self.rejected_len += 1;
        Refusals::count(&mut self.refusals, header.sender, why.cause(), 1);
    }

    /// Replaces the counts of a link to other boxes.
    pub fn set_link(&mut self, counts: impl IntoIterator<Item = (LinkCount, u64)>) {
        self.link = Default::default();
        Refusals::put_link(&mut self.link, counts);
    }

    /// When the next heartbeat is due, on `CLOCK_MONOTONIC`.
    pub const fn next_beat_ns(&self) -> u64 {
        self.next_beat_ns
    }

    /// The heartbeat to send now, with its number.
    pub fn beat(&mut self, inputs: &Inputs, now_ns: u64) -> Heartbeat {
        let heartbeat = self.heartbeat(inputs, now_ns);
        self.next_beat_ns = now_ns + HEARTBEAT.as_nanos() as u64;
        self.beat += 1;
        heartbeat
    }

    /// The current counts.
    pub fn heartbeat(&self, inputs: &Inputs, now_ns: u64) -> Heartbeat {
        let all = || inputs.all.iter();
        let mut refusals = self.refusals;
        all().for_each(|input| Refusals::add(&mut refusals, &input.refusals()));
        let link = self.link.iter().filter_map(|entry| Some((entry.link()?, entry.frames_len.into())));
        Refusals::put_link(&mut refusals, link);
        Heartbeat {
            stage: self.id.number(),
            incarnation: self.incarnation,
            pid: std::process::id(),
            linked: u32::from(self.has_passed && all().all(|input| input.linked())),
            beat: self.beat,
            seq: self.seq,
            frames_len: self.frames_len,
            rejected_len: self.rejected_len + all().map(|input| input.rejected_len()).sum::<u64>(),
            // A tick that was lost on its path is missing in all inputs.
            dropped_len: clamped(inputs.on_path().map(|input| input.dropped_len()).max().unwrap_or(0)),
            // A step begins with a frame of the first input.
            unanswered_len: clamped(all().next().map_or(0, |input| input.dropped_len())),
            sent_ns: now_ns,
            refusals,
        }
    }
}

/// A count in the format of a heartbeat.
fn clamped(count: u64) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use proptest::prelude::*;

    use super::*;

    /// An input with these counts.
    #[derive(Debug)]
    struct Counted {
        linked: bool,
        rejected: u64,
        dropped: u64,
        resumed: Cell<Option<u64>>,
    }

    impl Input for Counted {
        fn linked(&self) -> bool {
            self.linked
        }

        fn rejected_len(&self) -> u64 {
            self.rejected
        }

        fn refusals(&self) -> [Refusals; REFUSALS_MAX] {
            let mut refusals = [Refusals::default(); REFUSALS_MAX];
            let why = Rejected::Repeated { counter: 0, newest: 0 };
            Refusals::count(&mut refusals, StageId::Source.number(), why.cause(), self.rejected as u32);
            refusals
        }

        fn dropped_len(&self) -> u64 {
            self.dropped
        }

        fn resume_after(&self, seq: u64) {
            self.resumed.set(Some(seq));
        }
    }

    fn input() -> impl Strategy<Value = (bool, Rc<Counted>)> {
        (any::<bool>(), any::<bool>(), 0..9_u64, 0..u64::from(u32::MAX) * 2).prop_map(
            |(is_feedback, linked, rejected, dropped)| {
                let resumed = Cell::new(None);
                (is_feedback, Rc::new(Counted { linked, rejected, dropped, resumed }))
            },
        )
    }

    proptest! {
        #[test]
        fn a_heartbeat_sums_its_inputs_in_any_order(
            opened in prop::collection::vec(input(), 0..5), has_passed in any::<bool>(), refused in 0..5_u64,
        ) {
            let (mut inputs, mut tally) = (Inputs::default(), Tally::new(StageId::Sampler, 3));
            for (is_feedback, input) in &opened {
                if *is_feedback { inputs.add_feedback(input.clone()) } else { inputs.add(input.clone()) }
            }
            tally.has_passed = has_passed;
            for seq in 0..refused {
                let why = Rejected::Repeated { counter: 0, newest: 0 };
                tally.refuse(&Header { sender: StageId::Source.number(), ..Header::new(1, seq, 0) }, &why);
            }
            tally.finish(refused + 7);
            let heartbeat = tally.heartbeat(&inputs, 5);
            let on_path = || opened.iter().filter(|(is_feedback, _)| !is_feedback).map(|(_, input)| input);
            let most = on_path().map(|input| input.dropped).max().unwrap_or(0);
            let rejected = refused + opened.iter().map(|(_, input)| input.rejected).sum::<u64>();
            prop_assert_eq!(heartbeat.linked == 1, has_passed && opened.iter().all(|(_, input)| input.linked));
            prop_assert_eq!((heartbeat.rejected_len, heartbeat.dropped_len), (rejected, clamped(most)));
            prop_assert_eq!(u64::from(heartbeat.refusals[0].frames_len), rejected);
            let first = on_path().next().or(opened.first().map(|(_, input)| input));
            prop_assert_eq!(heartbeat.unanswered_len, clamped(first.map_or(0, |input| input.dropped)));
            prop_assert_eq!((heartbeat.frames_len, heartbeat.seq), (1, refused + 7));
            inputs.resume_after(4);
            for (is_feedback, input) in &opened {
                prop_assert_eq!(input.resumed.get(), (!is_feedback).then_some(4));
            }
        }

        #[test]
        fn heartbeats_are_numbered_and_due_at_a_fixed_interval(times in prop::collection::vec(0..1_u64 << 40, 1..9)) {
            let mut tally = Tally::new(StageId::Source, 0);
            for (number, now_ns) in (0..).zip(times) {
                let heartbeat = tally.beat(&Inputs::default(), now_ns);
                prop_assert_eq!((heartbeat.beat, heartbeat.sent_ns, heartbeat.linked), (number, now_ns, 1));
                prop_assert_eq!(tally.next_beat_ns(), now_ns + HEARTBEAT.as_nanos() as u64);
            }
        }
    }
}
