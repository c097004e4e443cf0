use std::collections::VecDeque;

use crate::Message;

/// Bytes of a message besides its content: its slots in the ring and in memory.
const MESSAGE_BYTES: usize = 96;

/// The limits of a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RingLimits {
    /// Time between its first message and its last.
    pub span_ns: u64,
    /// Memory.
    pub bytes: usize,
}

/// The newest messages of a run, in memory. A flight recorder writes them when an event occurs.
#[derive(Debug)]
pub struct Ring {
    limits: RingLimits,
    messages: VecDeque<Message>,
    bytes: usize,
    newest_ns: u64,
    /// Whether a message within the span was discarded.
    is_cut: bool,
}

impl Ring {
    /// An empty ring.
    #[must_use]
    pub const fn new(limits: RingLimits) -> Self {
        Self { limits, messages: VecDeque::new(), bytes: 0, newest_ns: 0, is_cut: false }
    }

    /// Adds a message. Messages that are too old or that do not fit are discarded, oldest first; `gone` is
    /// called with each. A message that is larger than the ring is not kept.
    pub fn push(&mut self, message: Message, mut gone: impl FnMut(Message)) {
        self.newest_ns = self.newest_ns.max(message.at_ns());
        self.bytes += weight(&message);
        self.messages.push_back(message);
        let oldest_ns = self.newest_ns.saturating_sub(self.limits.span_ns);
        while let Some(first) = self.messages.front() {
            let is_old = first.at_ns() < oldest_ns;
            if !is_old && self.bytes <= self.limits.bytes {
                break;
            }
            self.is_cut |= !is_old;
            self.bytes -= weight(first);
            if let Some(first) = self.messages.pop_front() {
                gone(first);
            }
        }
    }

    /// The messages in the order of arrival.
    pub fn messages(&self) -> impl ExactSizeIterator<Item = &Message> {
        self.messages.iter()
    }

    /// Time from the first message to the last.
    pub fn span_ns(&self) -> u64 {
        self.messages.front().map_or(0, |first| self.newest_ns.saturating_sub(first.at_ns()))
    }

    /// Whether the memory was ever too small for the whole span.
    pub const fn is_cut(&self) -> bool {
        self.is_cut
    }
}

fn weight(message: &Message) -> usize {
    let content = match message {
        Message::Frame(frame) | Message::Before(frame) => frame.bytes().len() + size_of::<wire::Header>(),
        Message::Event(_) => 256,
        Message::Line(line) => line.line.len() + line.stage.len(),
    };
    content + MESSAGE_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Frame, LogLine};
    use proptest::prelude::*;
    use wire::{Detection, DetectionsTopic, Header};

    fn frame(at_ns: u64, agents_len: usize) -> Message {
        let mut header = Header::new(1, at_ns, at_ns as i64);
        header.counts.agents_len = agents_len as u32;
        let detections = vec![Detection::default(); agents_len];
        Message::Frame(Frame::of::<DetectionsTopic>(&header, &detections, at_ns))
    }

    fn line(at_ns: u64, len: usize) -> Message {
        Message::Line(LogLine { at_ns, stage: "tracker".to_owned(), line: "x".repeat(len) })
    }

    #[test]
    fn the_oldest_messages_go_first_and_a_ring_that_is_too_small_says_so() {
        let mut ring = Ring::new(RingLimits { span_ns: 10, bytes: 1 << 20 });
        (0..30).for_each(|at_ns| ring.push(line(at_ns, 5), drop));
        let times: Vec<u64> = ring.messages().map(Message::at_ns).collect();
        assert_eq!(times, (19..30).collect::<Vec<_>>());
        assert!(!ring.is_cut() && ring.span_ns() == 10);
        ring.push(line(30, 2 << 20), drop);
        assert!(ring.is_cut() && ring.messages().len() == 0 && ring.bytes == 0);
    }

    proptest! {
        /// For any input: the limits hold, nothing is kept twice or out of order, and nothing is discarded
        /// without need.
        #[test]
        fn a_ring_keeps_its_bounds_and_no_less_than_it_may(
            messages in prop::collection::vec((0..400_u64, 0..60_usize, any::<bool>()), 1..120),
            span_ns in 1..2_000_u64,
            bytes in 1_000..200_000_usize,
        ) {
            let mut ring = Ring::new(RingLimits { span_ns, bytes });
            let (mut at_ns, mut all, mut went) = (0, Vec::new(), Vec::new());
            for (later_ns, len, is_frame) in messages {
                at_ns += later_ns;
                let message = if is_frame { frame(at_ns, len) } else { line(at_ns, len) };
                all.push(message.clone());
                ring.push(message, |message| went.push(message));
                prop_assert!(ring.bytes <= bytes && ring.span_ns() <= span_ns);
                let kept: Vec<&Message> = ring.messages().collect();
                prop_assert_eq!(ring.bytes, kept.iter().map(|message| weight(message)).sum::<usize>());
                let gone = all.len() - kept.len();
                prop_assert!(went == all[..gone], "what goes is handed on");
                prop_assert!(kept.iter().zip(&all[gone..]).all(|(a, b)| *a == b), "the newest, in order");
                if let Some(last_gone) = gone.checked_sub(1).map(|last| &all[last]) {
                    let is_old = last_gone.at_ns() + span_ns < at_ns;
                    prop_assert!(is_old || ring.is_cut());
                }
            }
        }
    }
}
