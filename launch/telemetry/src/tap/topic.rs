//! A topic as the tap reads it, independent of its element type.

use std::os::fd::{AsFd, BorrowedFd};

use ports::{Node, PortError, RawSubscriber, monotonic_ns};
use wire::{Header, TABLE};

/// A frame taken from its queue.
pub struct Taken<'a> {
    /// The topic's number.
    pub topic: u8,
    /// The time at which it was taken, `CLOCK_MONOTONIC`.
    pub received_ns: u64,
    /// Header, unchecked.
    pub header: &'a Header,
    /// Elements.
    pub payload: &'a [u8],
    /// Number of frames before it that the tap certainly missed.
    pub lost: u64,
}

/// An open topic.
pub struct Input {
    /// The topic's number.
    pub number: u8,
    subscriber: RawSubscriber,
    newest: Option<Place>,
}

impl Input {
    /// Opens a topic by number.
    pub fn open(node: &Node, number: u8) -> Result<Self, PortError> {
        let subscriber = node.raw_subscriber(&(&TABLE.topics[usize::from(number)]).into())?;
        Ok(Self { number, subscriber, newest: None })
    }

    /// Passes the pending frames to `each`.
    pub fn take(&mut self, mut each: impl FnMut(&Taken<'_>)) -> Result<(), PortError> {
        let has_one_writer = TABLE.topics[usize::from(self.number)].publishers_max == 1;
        self.subscriber.drain()?;
        while let Some(frame) = self.subscriber.receive()? {
            let (header, payload) = (frame.header(), frame.payload());
            let place = Place::of(header);
            let lost = if has_one_writer { place.lost_since(self.newest.as_ref()) } else { 0 };
            self.newest = Some(place);
            each(&Taken { topic: self.number, received_ns: monotonic_ns(), header, payload, lost });
        }
        Ok(())
    }

    /// Readable when a frame has arrived.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.subscriber.as_fd()
    }
}

/// A frame's position in its sender's sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Place {
    sender: (u32, u32),
    /// The counter of a protected frame.
    counter: Option<u32>,
    /// The tick, set only in lockstep. In lockstep no stage skips a tick.
    tick: Option<u64>,
}

impl Place {
    fn of(header: &Header) -> Self {
        let counter = (!header.protection.is_absent()).then_some(header.protection.counter);
        let is_tick = header.is_tick() && header.has(wire::flags::LOCKSTEP);
        Self { sender: (header.sender, header.incarnation), counter, tick: is_tick.then_some(header.seq) }
    }

    /// Counts the frames that were certainly lost between two positions. Outside lockstep and without a
    /// counter, a stage may have dropped the missing ticks.
    fn lost_since(&self, before: Option<&Self>) -> u64 {
        /// Counters farther apart belong to a restarted sender.
        const APART_MAX: u32 = 1 << 16;
        let Some(before) = before.filter(|before| before.sender == self.sender) else { return 0 };
        match (before.counter.zip(self.counter), before.tick.zip(self.tick)) {
            (Some((old, new)), _) => {
                let apart = new.wrapping_sub(old);
                if (1..=APART_MAX).contains(&apart) { u64::from(apart - 1) } else { 0 }
            }
            (None, Some((old, new))) => new.saturating_sub(old + 1),
            (None, None) => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::{Protection, flags};

    #[test]
    fn only_certain_losses_count_as_the_taps() {
        let place = |seq, counter: Option<u32>, flags| {
            let mut header = Header { flags, ..Header::new(1, seq, 0) };
            if let Some(counter) = counter {
                header.protection = Protection { counter, length: 704, ..Protection::default() };
            }
            Place::of(&header)
        };
        let lost = |new: Place, old: Place| new.lost_since(Some(&old));
        assert_eq!(lost(place(9, Some(5), 0), place(4, Some(2), 0)), 2, "by the counter");
        assert_eq!(lost(place(9, Some(1), 0), place(4, Some(u32::MAX), 0)), 1, "it wraps around");
        assert_eq!(lost(place(9, Some(3), 0), place(4, Some(90_000), 0)), 0, "it began anew");
        assert_eq!(lost(place(9, None, flags::LOCKSTEP), place(4, None, flags::LOCKSTEP)), 4);
        assert_eq!(lost(place(9, None, 0), place(4, None, 0)), 0, "a stage may have lost it");
        assert_eq!(place(9, None, 0).lost_since(None), 0);
    }
}
