//! Ticks that never arrive because their sender is gone.

use wire::{Counts, Header, flags};

/// Decides when a stage answers ticks that never arrived.
///
/// Two intervals after the last tick, it checks whether the input's sender is gone. If so, ticks are
/// predicted, one per interval, until the next tick arrives.
#[derive(Debug, Default)]
pub(crate) struct Missing {
    last: Option<Last>,
    is_gone: bool,
}

/// The last tick that arrived, and the ticks predicted since.
#[derive(Clone, Copy, Debug)]
struct Last {
    header: Header,
    received_ns: u64,
    predicted_count: u64,
    look_ns: u64,
}

impl Missing {
    /// Records a tick that arrived at `received_ns`. In lockstep no tick is missing, however late it is.
    pub fn arrive(&mut self, header: &Header, received_ns: u64) {
        let can_miss = header.interval_ns > 0 && !header.has(flags::LOCKSTEP);
        let last = Last { header: *header, received_ns, predicted_count: 0, look_ns: 0 };
        *self = Self { last: can_miss.then_some(last), is_gone: false };
    }

    /// Records a frame that is not a tick. Nothing follows the end of a recording. A warm-up frame means that
    /// another source starts and has not sent a tick yet.
    pub fn take_other(&mut self, header: &Header) {
        if header.has(flags::END) {
            *self = Self::default();
        }
        self.is_gone |= header.has(flags::WARM_UP);
    }

    /// When to check the sender, or to predict the next tick. `None` if no tick can be missing.
    pub fn until_ns(&self) -> Option<u64> {
        let last = self.last?;
        let interval_ns = last.header.interval_ns;
        let after_ns = last.received_ns + last.predicted_count * interval_ns;
        // If the source is known to be gone, a tick is predicted half an interval after it was due. When the
        // next source sends its first tick, the previous tick has then been answered.
        let due_ns = after_ns + if self.is_gone { interval_ns + interval_ns / 2 } else { 2 * interval_ns };
        Some(due_ns.max(last.look_ns))
    }

    /// The header of the tick to predict at `now_ns`. `None` if the sender is only silent, as in a gap of a
    /// recording.
    pub fn predict(&mut self, is_gone: bool, now_ns: u64) -> Option<Header> {
        self.is_gone |= is_gone;
        let last = self.last.as_mut()?;
        if !self.is_gone {
            // Four checks per interval notice an outage soon, and a check costs little.
            last.look_ns = now_ns + last.header.interval_ns / 4;
            return None;
        }
        last.predicted_count += 1;
        let after_ns = last.predicted_count.saturating_mul(last.header.interval_ns);
        let way = Header::new(last.header.run_id, 0, 0);
        let header = Header {
            seq: last.header.seq + last.predicted_count,
            stamp_ns: last.header.stamp_ns.saturating_add_unsigned(after_ns),
            flags: last.header.flags | flags::PREDICTED,
            // No type was observed, so no track was missed.
            observed_types: 0,
            left_out_len: 0,
            counts: Counts::default(),
            ..last.header
        };
        Some(header.with_hops_of(&way))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_NS: u64 = 80;

    fn header(seq: u64, flags: u32) -> Header {
        Header { interval_ns: INTERVAL_NS, flags, ..Header::new(1, seq, (seq * INTERVAL_NS) as i64) }
    }

    #[test]
    fn ticks_are_predicted_one_per_interval_once_the_source_is_gone() {
        let mut missing = Missing::default();
        assert_eq!(missing.until_ns(), None);
        missing.arrive(&header(7, 0), 1_000);
        assert_eq!(missing.until_ns(), Some(1_160));
        assert!(missing.predict(false, 1_160).is_none(), "the source is there");
        assert_eq!(missing.until_ns(), Some(1_180));
        let predicted = missing.predict(true, 1_180).expect("the source is gone");
        assert_eq!((predicted.seq, predicted.stamp_ns), (8, 640));
        assert!(predicted.has(flags::PREDICTED) && predicted.observed_types == 0);
        assert_eq!(missing.until_ns(), Some(1_200));
        let predicted = missing.predict(false, 1_200).expect("back, and no tick yet");
        assert_eq!((predicted.seq, predicted.stamp_ns), (9, 720));
        missing.arrive(&header(10, 0), 1_300);
        assert!(missing.predict(false, 1_460).is_none());
        missing.take_other(&header(10, flags::WARM_UP));
        assert!(missing.predict(false, 1_460).is_some(), "another source begins");
        missing.take_other(&header(10, flags::END));
        assert_eq!(missing.until_ns(), None);
    }

    #[test]
    fn at_an_unknown_interval_nothing_is_missing() {
        let mut missing = Missing::default();
        missing.arrive(&Header { interval_ns: 0, ..header(7, 0) }, 1_000);
        assert_eq!(missing.until_ns(), None);
        assert!(missing.predict(true, 9_000).is_none());
    }

    #[test]
    fn in_lockstep_nothing_is_missing() {
        let mut missing = Missing::default();
        missing.arrive(&header(7, flags::LOCKSTEP), 1_000);
        assert_eq!(missing.until_ns(), None);
    }
}
