//! The effects of an injector on frames: pure functions of a frame, the faults of its topic and their seeds.

use serde::{Deserialize, Serialize};
use wire::{Header, Leaf, Primitive, Record};

/// The effect on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Effect {
    /// The frame is forwarded later; later frames may overtake it.
    Delay {
        /// The minimum delay in milliseconds.
        #[serde(rename = "delay_ms")]
        ms: u64,
        /// The maximum additional delay in milliseconds.
        #[serde(default)]
        jitter_ms: u64,
    },
    /// The frame is dropped.
    Drop {},
    /// The frame is forwarded twice.
    Duplicate {},
    /// The frame is forwarded after the next frame.
    Reorder {},
    /// Some bits of the frame are flipped.
    BitFlip {
        /// Number of flipped bits.
        #[serde(default = "one")]
        bits: u32,
        /// The part in which bits are flipped: header or payload.
        #[serde(rename = "in", default = "payload")]
        part: Part,
    },
    /// One number of the frame is replaced by a non-finite one.
    NotFinite {},
    /// One number of the frame is replaced by 1e30.
    Huge {},
    /// The frame loses one element, or gains one if it is empty.
    WrongLength {},
    /// The schema version is increased by one.
    WrongSchema {},
    /// The frame carries another run's id.
    ForeignRun {},
    /// From the first tick on, the sender is in its next incarnation. The affected frames carry the previous
    /// one.
    OldIncarnation {},
    /// The frame repeats the stamp or the payload of the first frame.
    Frozen {
        /// The part that is repeated: stamp or payload.
        #[serde(rename = "in")]
        part: Part,
    },
    /// The stamp is shifted.
    ClockJump {
        /// The shift in milliseconds; negative means earlier.
        #[serde(rename = "jump_ms")]
        ms: i64,
    },
}

/// A part of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    Header,
    Payload,
    /// The time of validity.
    Stamp,
}

const fn one() -> u32 {
    1
}

const fn payload() -> Part {
    Part::Payload
}

impl Effect {
    /// The names of all effects.
    pub const NAMES: [&'static str; 13] = [
        "delay",
        "drop",
        "duplicate",
        "reorder",
        "bit-flip",
        "not-finite",
        "huge",
        "wrong-length",
        "wrong-schema",
        "foreign-run",
        "old-incarnation",
        "frozen",
        "clock-jump",
    ];

    /// Whether the effect imitates a sender with wrong content, not damage in transport.
    const fn is_lie(self) -> bool {
        matches!(
            self,
            Self::NotFinite {}
                | Self::Huge {}
                | Self::WrongLength {}
                | Self::WrongSchema {}
                | Self::ForeignRun {}
                | Self::OldIncarnation {}
                | Self::Frozen { .. }
                | Self::ClockJump { .. }
        )
    }

    /// Returns the kind of fault as a specification writes it.
    pub const fn name(self) -> &'static str {
        Self::NAMES[match self {
            Self::Delay { .. } => 0,
            Self::Drop {} => 1,
            Self::Duplicate {} => 2,
            Self::Reorder {} => 3,
            Self::BitFlip { .. } => 4,
            Self::NotFinite {} => 5,
            Self::Huge {} => 6,
            Self::WrongLength {} => 7,
            Self::WrongSchema {} => 8,
            Self::ForeignRun {} => 9,
            Self::OldIncarnation {} => 10,
            Self::Frozen { .. } => 11,
            Self::ClockJump { .. } => 12,
        }]
    }
}

/// A frame inside the injector, with its elements as bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw {
    pub header: Header,
    /// The elements, concatenated.
    pub payload: Vec<u8>,
    /// Whether the sender itself is wrong. The check value then matches the wrong content; after transport
    /// damage it does not.
    pub is_lie: bool,
}

/// A frame to be sent, after a delay.
#[derive(Clone, Debug, PartialEq)]
pub struct Due {
    pub frame: Raw,
    /// Nanoseconds from now.
    pub delay_ns: u64,
}

/// The faults of one topic and their state between frames.
#[derive(Debug)]
pub struct Injector {
    faults: Vec<TopicFault>,
    /// Size of an element in bytes.
    size: usize,
    /// Offsets of the single-precision numbers in an element, as far as its fields are known.
    reals: Vec<usize>,
    /// The first affected frame of each fault.
    first: Vec<Option<Raw>>,
    /// A frame held back until the next one.
    held: Option<Raw>,
}

impl Injector {
    /// Creates the injector of a topic from the element's size and, if known, its fields.
    pub fn new(faults: Vec<TopicFault>, size: usize, element: Option<&Record>) -> Self {
        let leaves = element.map_or_else(Vec::new, Record::leaves);
        let is_real = |leaf: &&Leaf| leaf.primitive == Primitive::F32;
        let reals = leaves.iter().filter(is_real).map(|leaf| leaf.offset).collect();
        let first = faults.iter().map(|_| None).collect();
        Self { faults, size, reals, first, held: None }
    }

    /// Returns the frames to send and the kinds of faults that acted on this frame.
    pub fn pass(&mut self, frame: Raw) -> (Vec<Due>, Vec<&'static str>) {
        let mut acted = Vec::new();
        let (tick, mut frame) = (frame_tick(&frame), frame);
        let (mut delay_ns, mut copies, mut holds) = (0, 1, false);
        for i in 0..self.faults.len() {
            let TopicFault { effect, ticks: [first, last], probability, seed, .. } = self.faults[i];
            let Some(tick) = tick else { continue };
            let mut random = Random::new(seed ^ (i as u64) << 32, tick);
            let acts = (first..=last).contains(&tick) && random.share() < probability;
            if matches!(effect, Effect::OldIncarnation {}) && tick >= first && (!acts || tick == first) {
                frame.header.incarnation += 1;
                frame.is_lie = true;
                continue;
            }
            // Only one frame at a time is held back.
            if !acts || (matches!(effect, Effect::Reorder {}) && self.held.is_some()) {
                continue;
            }
            acted.push(effect.name());
            match effect {
                Effect::Delay { ms, jitter_ms } => {
                    delay_ns += 1_000_000 * (ms + random.below(jitter_ms + 1));
                }
                Effect::Drop {} => copies = 0,
                Effect::Duplicate {} => copies *= 2,
                Effect::Reorder {} => holds = true,
                _ => self.change(i, effect, &mut frame, &mut random),
            }
        }
        let mut due = vec![Due { frame: frame.clone(), delay_ns }; copies];
        if holds && copies > 0 && self.held.is_none() {
            self.held = due.pop().map(|due| due.frame);
        } else if let Some(held) = self.held.take() {
            due.push(Due { frame: held, delay_ns });
        }
        (due, acted)
    }

    /// Changes a frame's content.
    fn change(&mut self, fault: usize, effect: Effect, frame: &mut Raw, random: &mut Random) {
        let first = self.first[fault].get_or_insert_with(|| frame.clone());
        let Raw { header, payload, is_lie } = frame;
        *is_lie = effect.is_lie();
        match effect {
            Effect::BitFlip { bits, part: Part::Payload } => flip(payload, bits, random),
            Effect::BitFlip { bits, .. } => {
                flip(bytemuck::bytes_of_mut(header), bits, random);
            }
            Effect::NotFinite {} => self.set_real(payload, f32::NAN, random),
            Effect::Huge {} => self.set_real(payload, 1e30, random),
            Effect::WrongLength {} if payload.is_empty() => payload.resize(self.size, 0),
            Effect::WrongLength {} => payload.truncate(payload.len() - self.size),
            Effect::WrongSchema {} => header.schema += 1,
            Effect::ForeignRun {} => header.run_id ^= 1,
            Effect::Frozen { part: Part::Payload } => {
                payload.clone_from(&first.payload);
                header.counts = first.header.counts;
            }
            Effect::Frozen { .. } => header.stamp_ns = first.header.stamp_ns,
            Effect::ClockJump { ms } => header.stamp_ns += ms * 1_000_000,
            Effect::Delay { .. }
            | Effect::Drop {}
            | Effect::Duplicate {}
            | Effect::Reorder {}
            | Effect::OldIncarnation {} => {}
        }
    }

    /// Overwrites one single-precision number of one element.
    fn set_real(&self, payload: &mut [u8], value: f32, random: &mut Random) {
        let elements = payload.len() / self.size;
        if elements > 0 && !self.reals.is_empty() {
            let real = self.reals[random.below(self.reals.len() as u64) as usize];
            let at = random.below(elements as u64) as usize * self.size + real;
            payload[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
    }
}

/// Returns the frame's tick; `None` for frames that link or end the pipeline.
fn frame_tick(frame: &Raw) -> Option<u64> {
    frame.header.is_tick().then_some(frame.header.seq)
}

fn flip(bytes: &mut [u8], bits: u32, random: &mut Random) {
    for _ in 0..bits {
        if !bytes.is_empty() {
            let bit = random.below(8 * bytes.len() as u64);
            bytes[bit as usize / 8] ^= 1 << (bit % 8);
        }
    }
}

/// Random numbers from a seed and a tick (SplitMix64). They do not depend on earlier ticks.
#[derive(Clone, Copy, Debug)]
pub struct Random(u64);

impl Random {
    /// Creates the generator of a seed and a tick.
    pub const fn new(seed: u64, tick: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ tick.wrapping_mul(0xD1B5_4A32_D192_ED03))
    }

    const fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Returns a uniform number in [0, 1).
    const fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns a number below `limit`, which must not be 0.
    pub const fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }
}

/// A fault between a topic's writer and its readers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TopicFault {
    pub topic: String,
    /// The effect on a frame.
    pub effect: Effect,
    /// The range of ticks on which it may act, inclusive.
    pub ticks: [u64; 2],
    /// The probability that it acts on a tick.
    pub probability: f64,
    /// Seed of this random choice and of the effect.
    pub seed: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::{TABLE, Track, flags};

    fn injector(effect: Effect, ticks: [u64; 2], probability: f64) -> Injector {
        let tracks = TABLE.topics.iter().find(|topic| topic.name == "tracks").unwrap();
        let fault = TopicFault { topic: "tracks".into(), effect, ticks, probability, seed: 3 };
        Injector::new(vec![fault], tracks.element.size, Some(tracks.element))
    }

    fn frame(seq: u64) -> Raw {
        let mut header = Header::new(7, seq, seq as i64 * 80_000_000);
        header.counts.agents_len = 2;
        Raw { header, payload: vec![0; 2 * size_of::<Track>()], is_lie: false }
    }

    /// Returns the ticks of the outgoing frames and the number of affected frames.
    fn order(injector: &mut Injector, len: u64) -> (Vec<u64>, usize) {
        let (mut ticks, mut acted) = (Vec::new(), 0);
        for seq in 0..len {
            let (due, kinds) = injector.pass(frame(seq));
            ticks.extend(due.iter().map(|due| due.frame.header.seq));
            acted += kinds.len();
        }
        (ticks, acted)
    }

    #[test]
    fn frames_are_dropped_duplicated_and_reordered_in_the_range_alone() {
        assert_eq!(order(&mut injector(Effect::Drop {}, [1, 2], 1.0), 5), (vec![0, 3, 4], 2));
        assert_eq!(order(&mut injector(Effect::Duplicate {}, [1, 1], 1.0), 3), (vec![0, 1, 1, 2], 1));
        assert_eq!(order(&mut injector(Effect::Reorder {}, [1, 1], 1.0), 4), (vec![0, 2, 1, 3], 1));
    }

    #[test]
    fn a_probability_repeats_with_its_seed_and_is_met() {
        let drop = || injector(Effect::Drop {}, [0, 9_999], 0.25);
        let (kept, dropped) = order(&mut drop(), 10_000);
        assert_eq!(order(&mut drop(), 10_000), (kept, dropped));
        assert!((2_300..2_700).contains(&dropped), "{dropped}");
    }

    #[test]
    fn content_is_changed_where_the_fault_says() {
        let changed = |effect| {
            let mut injector = injector(effect, [1, 9], 1.0);
            let _ = injector.pass(frame(1));
            injector.pass(frame(2)).0.remove(0).frame
        };
        let count_bits = |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum::<u32>();
        let same = frame(2);
        let flipped = changed(Effect::BitFlip { bits: 1, part: Part::Payload });
        assert_eq!((count_bits(&flipped.payload, &same.payload), flipped.header), (1, same.header));
        assert!(
            !flipped.is_lie && changed(Effect::NotFinite {}).is_lie && changed(Effect::ForeignRun {}).is_lie
        );
        let flipped = changed(Effect::BitFlip { bits: 1, part: Part::Header });
        let bits = count_bits(bytemuck::bytes_of(&flipped.header), bytemuck::bytes_of(&same.header));
        assert_eq!((bits, flipped.payload == same.payload), (1, true));
        let not_finite = changed(Effect::NotFinite {}).payload;
        assert_eq!(not_finite.chunks(4).filter(|bytes| *bytes == f32::NAN.to_le_bytes()).count(), 1);
        assert_eq!(not_finite.len(), 2 * size_of::<Track>());
        assert_eq!(changed(Effect::WrongLength {}).payload.len(), size_of::<Track>());
        assert_eq!(changed(Effect::ForeignRun {}).header.run_id, 6);
        assert_eq!(changed(Effect::WrongSchema {}).header.schema, wire::SCHEMA + 1);
        assert_eq!(changed(Effect::Frozen { part: Part::Stamp }).header.stamp_ns, 80_000_000);
        assert_eq!(changed(Effect::ClockJump { ms: -80 }).header.stamp_ns, 80_000_000);
        assert_eq!(
            injector(Effect::Delay { ms: 40, jitter_ms: 0 }, [0, 9], 1.0).pass(frame(1)).0[0].delay_ns,
            40_000_000
        );
    }

    #[test]
    fn an_old_incarnation_comes_after_the_new_one() {
        let mut injector = injector(Effect::OldIncarnation {}, [1, 3], 1.0);
        let incarnations: Vec<u32> =
            (0..6).map(|seq| injector.pass(frame(seq)).0[0].frame.header.incarnation).collect();
        assert_eq!(incarnations, [0, 1, 0, 0, 1, 1]);
    }

    #[test]
    fn frames_that_link_the_pipeline_pass_untouched() {
        let mut injector = injector(Effect::Drop {}, [0, 99], 1.0);
        let mut warm_up = frame(0);
        warm_up.header.flags = flags::WARM_UP;
        let (due, acted) = injector.pass(warm_up.clone());
        assert_eq!((due, acted), (vec![Due { frame: warm_up, delay_ns: 0 }], vec![]));
    }
}
