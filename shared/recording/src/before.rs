use std::sync::Arc;

use lz4_flex::block::{compress_prepend_size, decompress_size_prepended};
use wire::{Detection, DetectionsTopic, ForecastsTopic, Topic, TracksTopic};

use crate::Frame;

/// Frames are compressed when this many bytes are pending.
const BLOCK_BYTES: usize = 1 << 18;
/// Tracks and forecasts keep only the header and the ids.
const IDENTITY_BYTES: usize = size_of::<u64>();
/// Bytes before a frame's data: topic, bytes of an element, time of receipt, length.
const PREFIX: usize = 1 + 4 + 8 + 4;

/// The topics that are kept, with the number of leading bytes of each element.
const KEPT: [(&str, usize); 3] = [
    (DetectionsTopic::NAME, size_of::<Detection>()),
    (TracksTopic::NAME, IDENTITY_BYTES),
    (ForecastsTopic::NAME, IDENTITY_BYTES),
];

/// The inputs of a run's stages from the start of the run, compressed in memory. The inputs are the
/// detections and the headers of tracks and forecasts. The headers record the work of each stage in each
/// tick. A replay of these frames brings the stages to the same state, for any length of their memory.
#[derive(Debug)]
pub struct Before {
    limit_bytes: usize,
    packed: Vec<Vec<u8>>,
    packed_bytes: usize,
    open: Vec<u8>,
    state: State,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Empty,
    /// The first tick's output has arrived before its detections. Topics do not wait for each other.
    Early,
    /// Complete from the run's first tick.
    Whole,
    /// Incomplete: the run had started earlier, or the memory limit was reached.
    Gone,
}

/// Why the earlier frames are no longer kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Forgotten {
    /// The run had started before the first received frame.
    HadBegun,
    /// The memory limit was reached.
    TooMuch,
}

/// Number of leading bytes kept of each element of a topic; `None` if the topic is not kept.
pub(crate) fn kept_bytes(topic: &str) -> Option<usize> {
    KEPT.iter().find(|(name, _)| *name == topic).map(|(_, bytes)| *bytes)
}

impl Before {
    /// An empty buffer with a memory limit. It keeps frames only if `topics` contains the topics that a
    /// replay needs.
    #[must_use]
    pub fn new(limit_bytes: usize, topics: &[String]) -> Self {
        let has_all = KEPT.iter().all(|(name, _)| topics.iter().any(|topic| topic == name));
        let state = if has_all && limit_bytes > 0 { State::Empty } else { State::Gone };
        Self { limit_bytes, packed: Vec::new(), packed_bytes: 0, open: Vec::new(), state }
    }

    /// Adds a frame that is older than all frames kept elsewhere. If the buffer gives up at this frame,
    /// returns the reason.
    pub fn push(&mut self, frame: &Frame) -> Option<Forgotten> {
        let (header, topic) = (frame.header(), frame.topic().name);
        let bytes = kept_bytes(topic)?;
        if self.state == State::Gone || !header.is_tick() {
            return None;
        }
        match self.state {
            State::Empty | State::Early if topic == DetectionsTopic::NAME && header.seq == 0 => {
                self.state = State::Whole;
            }
            State::Empty if header.seq == 0 => self.state = State::Early,
            State::Early if topic != DetectionsTopic::NAME => {}
            State::Empty | State::Early => {
                *self = self.forgotten();
                return Some(Forgotten::HadBegun);
            }
            State::Whole | State::Gone => {}
        }
        let frame = frame.leading(bytes);
        self.open.push(frame.number());
        self.open.extend((frame.element_bytes() as u32).to_le_bytes());
        self.open.extend(frame.received_ns().to_le_bytes());
        self.open.extend((frame.bytes().len() as u32).to_le_bytes());
        self.open.extend_from_slice(frame.bytes());
        if self.open.len() >= BLOCK_BYTES {
            let packed = compress_prepend_size(&self.open);
            self.open.clear();
            self.packed_bytes += packed.len();
            self.packed.push(packed);
        }
        if self.bytes() <= self.limit_bytes {
            return None;
        }
        *self = self.forgotten();
        Some(Forgotten::TooMuch)
    }

    /// The buffer without its content.
    fn forgotten(&self) -> Self {
        Self::new(self.limit_bytes, &[])
    }

    /// Whether the buffer contains the run from its start up to the frames that are kept elsewhere.
    pub fn is_whole(&self) -> bool {
        self.state == State::Whole
    }

    /// Memory in use.
    pub fn bytes(&self) -> usize {
        self.packed_bytes + self.open.len()
    }

    /// The frames in the order of arrival; empty if the buffer is not complete.
    pub fn frames(&self) -> impl Iterator<Item = Frame> {
        // This type compressed the blocks, so decompressing them can't fail.
        let packed = self.packed.iter().filter(|_| self.is_whole());
        let packed = packed.filter_map(|packed| decompress_size_prepended(packed).ok());
        let open = self.is_whole().then(|| self.open.clone());
        packed.chain(open).flat_map(|block| unpacked(&block))
    }
}

/// Decompresses the frames of a block.
fn unpacked(block: &[u8]) -> Vec<Frame> {
    let mut rest = block;
    let mut frames = Vec::new();
    while let Some((prefix, tail)) = rest.split_at_checked(PREFIX) {
        let number =
            |at: usize| u32::from_le_bytes([prefix[at], prefix[at + 1], prefix[at + 2], prefix[at + 3]]);
        let received_ns = u64::from(number(5)) | u64::from(number(9)) << 32;
        let Some((bytes, tail)) = tail.split_at_checked(number(13) as usize) else { break };
        let bytes: Arc<[u8]> = bytes.into();
        frames.extend(Frame::read_leading(prefix[0], number(1) as usize, bytes, received_ns));
        rest = tail;
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use wire::{Forecast, Header, Track};

    fn topics() -> Vec<String> {
        KEPT.map(|(name, _)| name.to_owned()).to_vec()
    }

    fn header(seq: u64) -> Header {
        let mut header = Header::new(1, seq, seq as i64);
        header.counts.agents_len = 2;
        header
    }

    fn detections(seq: u64) -> Frame {
        let detections = [7, 8].map(|id| Detection { id, x_m: seq as f32, ..Zeroable::zeroed() });
        Frame::of::<DetectionsTopic>(&header(seq), &detections, seq)
    }

    #[test]
    fn detections_come_back_whole_and_the_others_with_their_headers() {
        let mut before = Before::new(1 << 24, &topics());
        for seq in 0..400 {
            let track = Track { id: seq, x_m: 1.0, ..Zeroable::zeroed() };
            let forecast = Forecast { id: seq, x_m: 1.0, ..Zeroable::zeroed() };
            assert_eq!(before.push(&detections(seq)), None);
            assert_eq!(before.push(&Frame::of::<TracksTopic>(&header(seq), &[track; 2], 9)), None);
            assert_eq!(before.push(&Frame::of::<ForecastsTopic>(&header(seq), &[forecast; 2], 9)), None);
        }
        assert!(before.is_whole() && before.bytes() < BLOCK_BYTES + 100_000, "{} bytes", before.bytes());
        let frames: Vec<Frame> = before.frames().collect();
        assert_eq!(frames.len(), 1_200);
        for (seq, frames) in frames.chunks_exact(3).enumerate() {
            assert_eq!(frames[0], detections(seq as u64));
            let tracks = frames[1].elements::<TracksTopic>().unwrap();
            assert_eq!((tracks[1].id, tracks[1].x_m, frames[1].header().seq), (seq as u64, 0.0, seq as u64));
            assert_eq!(frames[2].elements::<ForecastsTopic>().unwrap()[0].id, seq as u64);
        }
    }

    #[test]
    fn topics_of_the_first_tick_come_in_any_order() {
        let tracks = |seq| Frame::of::<TracksTopic>(&header(seq), &[Track::zeroed(); 2], 9);
        let mut before = Before::new(1 << 24, &topics());
        for frame in [tracks(0), tracks(1)] {
            assert_eq!(before.push(&frame), None);
            assert!(!before.is_whole() && before.frames().next().is_none());
        }
        assert_eq!(before.push(&detections(0)), None);
        assert!(before.is_whole() && before.frames().count() == 3);

        let mut lost = Before::new(1 << 24, &topics());
        assert_eq!(lost.push(&tracks(0)), None);
        assert_eq!(lost.push(&detections(1)), Some(Forgotten::HadBegun));
        assert!(!lost.is_whole() && lost.bytes() == 0 && lost.push(&detections(2)).is_none());
        let mut late = Before::new(1 << 24, &topics());
        assert_eq!(late.push(&tracks(1)), Some(Forgotten::HadBegun));
    }

    #[test]
    fn what_does_not_begin_with_the_run_or_has_no_room_is_not_kept() {
        let mut late = Before::new(1 << 24, &topics());
        assert_eq!(late.push(&detections(5)), Some(Forgotten::HadBegun));
        assert!(!late.is_whole() && late.frames().next().is_none() && late.push(&detections(6)).is_none());
        let mut small = Before::new(10_000, &topics());
        let found = (0..100).find_map(|seq| Some((seq, small.push(&detections(seq))?)));
        assert!(matches!(found, Some((5..50, Forgotten::TooMuch))), "{found:?}");
        assert!(!small.is_whole() && small.bytes() == 0 && small.push(&detections(100)).is_none());
        assert!(!Before::new(1 << 24, &topics()[..2]).is_whole());
    }
}
