//! A topic as the tap reads it, independent of its element type.

use std::os::fd::{AsFd, BorrowedFd};

use ports::{Node, PortError, RawSubscriber, monotonic_ns};
use recording::topic_number;
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, Header,
    HeartbeatsTopic, Topic, TracksTopic, TruthTopic,
};

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
pub trait Input {
    /// The topic's number.
    fn number(&self) -> u8;
    /// Passes the pending frames to `each`.
    fn take(&mut self, each: &mut dyn FnMut(&Taken<'_>)) -> Result<(), PortError>;
    /// Readable when a frame has arrived.
    fn descriptor(&self) -> BorrowedFd<'_>;
}

/// Opens a topic by name.
pub fn open(node: &Node, name: &str) -> Result<Option<Box<dyn Input>>, PortError> {
    Ok(Some(match name {
        DetectionsTopic::NAME => input::<DetectionsTopic>(node)?,
        TracksTopic::NAME => input::<TracksTopic>(node)?,
        ContextTopic::NAME => input::<ContextTopic>(node)?,
        FeaturesTopic::NAME => input::<FeaturesTopic>(node)?,
        EncodingsTopic::NAME => input::<EncodingsTopic>(node)?,
        ControlsTopic::NAME => input::<ControlsTopic>(node)?,
        ForecastsTopic::NAME => input::<ForecastsTopic>(node)?,
        TruthTopic::NAME => input::<TruthTopic>(node)?,
        HeartbeatsTopic::NAME => input::<HeartbeatsTopic>(node)?,
        _ => return Ok(None),
    }))
}

fn input<T: Topic>(node: &Node) -> Result<Box<dyn Input>, PortError> {
    let number = topic_number(T::NAME).expect("every topic is in the table");
    Ok(Box::new(Reading::<T> { number, subscriber: node.raw_subscriber(T::DEPTH_MAX)?, newest: None }))
}

struct Reading<T: Topic> {
    number: u8,
    subscriber: RawSubscriber<T>,
    newest: Option<Place>,
}

impl<T: Topic> Input for Reading<T> {
    fn number(&self) -> u8 {
        self.number
    }

    fn take(&mut self, each: &mut dyn FnMut(&Taken<'_>)) -> Result<(), PortError> {
        self.subscriber.drain()?;
        while let Some(frame) = self.subscriber.receive()? {
            let (header, payload) = (frame.header(), bytemuck::cast_slice(frame.elements()));
            let place = Place::of(header);
            let lost = if T::PUBLISHERS_MAX == 1 { place.lost_since(self.newest.as_ref()) } else { 0 };
            self.newest = Some(place);
            each(&Taken { topic: self.number, received_ns: monotonic_ns(), header, payload, lost });
        }
        Ok(())
    }

    fn descriptor(&self) -> BorrowedFd<'_> {
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
