//! Compares two recordings, or a recording and its replay, frame by frame. The result contains the first
//! difference, its size, and its growth along the topics.
//!
//! The comparison covers the results that the stages compute. Fields that depend on the time and place of a
//! run are ignored: the header's run id, protection, sender, incarnation, time of release and hops.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use serde::Serialize;
use wire::{
    AgentFeatures, ContextShape, ContextTopic, Edge, FeatureShape, FeaturesTopic, Field, HOPS_MAX, Header,
    HeartbeatsTopic, Hop, InputCounts, Leaf, Primitive, Protection, Record, Row, TABLE, Topic, Track, Type,
};

use crate::{Frame, Message, ReadError, Recording};

/// A number that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// The topic.
    pub topic: &'static str,
    /// The path of the number, such as `[3].modes[2][0][1]` or `header.flags`.
    pub field: String,
    /// Value in the first recording.
    pub a: f64,
    /// Value in the second recording.
    pub b: f64,
}

impl Difference {
    /// The absolute difference of the values; infinite if the difference is not a number.
    pub fn apart(&self) -> f64 {
        let apart = (self.a - self.b).abs();
        if apart.is_nan() { f64::INFINITY } else { apart }
    }
}

/// The differences of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameDifference {
    /// The first number that differs.
    pub first: Difference,
    /// The number with the greatest difference.
    pub farthest: Difference,
    /// Number of differing numbers.
    pub numbers: u64,
}

/// The comparison of one topic's frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TopicComparison {
    /// Ticks that both recordings have.
    pub ticks: u64,
    /// Number of these ticks that differ.
    pub different: u64,
    /// Ticks that only the first recording has.
    pub only_a: u64,
    /// Ticks that only the second recording has.
    pub only_b: u64,
    /// The first difference.
    pub first: Option<Difference>,
    /// The greatest difference.
    pub farthest: Option<Difference>,
    /// The first tick that only one recording has.
    pub first_alone: Option<u64>,
    /// The last tick that differs.
    pub last: Option<u64>,
    /// The greatest difference of each tick that differs.
    #[serde(skip)]
    pub growth: BTreeMap<u64, f64>,
}

/// The comparison of all topics.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// By topic, in the order in which a tick passes them.
    pub topics: Vec<(&'static str, TopicComparison)>,
}

impl Comparison {
    /// The first difference: in the earliest tick, on the first topic of the tick's path.
    pub fn first(&self) -> Option<&Difference> {
        let firsts = self.topics.iter().filter_map(|(_, topic)| topic.first.as_ref());
        // `min_by_key` returns the first of equal elements.
        firsts.min_by_key(|difference| difference.tick)
    }

    /// Whether nothing differs and nothing is missing.
    pub fn is_equal(&self) -> bool {
        let same = |topic: &TopicComparison| topic.different + topic.only_a + topic.only_b == 0;
        self.topics.iter().all(|(_, topic)| same(topic))
    }

    /// Number of compared ticks, of the topic with most ticks.
    pub fn ticks(&self) -> u64 {
        self.topics.iter().map(|(_, topic)| topic.ticks).max().unwrap_or(0)
    }

    /// Compares two frames of the same topic and tick.
    pub fn pair(&mut self, a: &Frame, b: &Frame) {
        let tick = a.header().seq;
        let found = compare(a, b);
        let topic = self.topic(a.topic().name);
        topic.ticks += 1;
        if let Some(FrameDifference { first, farthest, .. }) = found {
            topic.different += 1;
            topic.last = topic.last.max(Some(tick));
            topic.growth.insert(tick, farthest.apart());
            if topic.first.as_ref().is_none_or(|known| tick < known.tick) {
                topic.first = Some(first);
            }
            if topic.farthest.as_ref().is_none_or(|known| farthest.apart() > known.apart()) {
                topic.farthest = Some(farthest);
            }
        }
    }

    /// Counts a tick that only one of the recordings has.
    pub fn alone(&mut self, topic: &'static str, tick: u64, is_a: bool) {
        let topic = self.topic(topic);
        *if is_a { &mut topic.only_a } else { &mut topic.only_b } += 1;
        topic.first_alone = Some(topic.first_alone.map_or(tick, |first| first.min(tick)));
    }

    fn topic(&mut self, name: &'static str) -> &mut TopicComparison {
        let order = |name: &str| TABLE.topics.iter().position(|topic| topic.name == name);
        let at = self.topics.partition_point(|(known, _)| order(known) < order(name));
        if self.topics.get(at).is_none_or(|(known, _)| *known != name) {
            self.topics.insert(at, (name, TopicComparison::default()));
        }
        &mut self.topics[at].1
    }

    /// Compares two recordings: the ticks of all topics that both have, except heartbeats. Damaged parts of
    /// the files are skipped; [`Recording::damages`] returns them.
    #[must_use]
    pub fn of(a: &Recording, b: &Recording) -> Self {
        let mut comparison = Self::default();
        let both = |name: &str| a.has_topic(name) && b.has_topic(name) && name != HeartbeatsTopic::NAME;
        let (mut left, mut right) = (a.messages(), b.messages());
        // Frames that wait for their counterpart, with their recording.
        let mut waiting: HashMap<(u8, u64), (bool, Frame)> = HashMap::new();
        let mut take = |message: Option<Result<Message, ReadError>>, is_a: bool| {
            let Some(message) = message else { return false };
            if let Ok(Message::Frame(frame)) = message
                && frame.header().is_tick()
                && both(frame.topic().name)
            {
                let key = (frame.number(), frame.header().seq);
                match waiting.remove(&key) {
                    Some((of_a, other)) if of_a != is_a => {
                        let (a, b) = if is_a { (&frame, &other) } else { (&other, &frame) };
                        comparison.pair(a, b);
                    }
                    // If a tick occurs twice in one file, the second one counts.
                    _ => drop(waiting.insert(key, (is_a, frame))),
                }
            }
            true
        };
        let mut has_more = (true, true);
        while has_more.0 || has_more.1 {
            has_more = (take(left.next(), true), take(right.next(), false));
        }
        for (is_a, frame) in waiting.into_values() {
            comparison.alone(frame.topic().name, frame.header().seq, is_a);
        }
        comparison
    }
}

/// A header without the fields that depend on the time and place of its run.
#[must_use]
pub fn computed(header: &Header) -> Header {
    Header {
        protection: Protection::default(),
        run_id: 0,
        released_ns: 0,
        sender: 0,
        incarnation: 0,
        hops_len: 0,
        hops_missing_len: 0,
        hops: [Hop::default(); HOPS_MAX],
        ..*header
    }
}

/// The differences between two frames of a topic and a tick; `None` if they are equal.
#[must_use]
pub fn compare(a: &Frame, b: &Frame) -> Option<FrameDifference> {
    // If one of the frames was recorded in part, only that part is compared.
    let common = a.element_bytes().min(b.element_bytes());
    if a.element_bytes() != b.element_bytes() {
        return compare(&a.leading(common), &b.leading(common));
    }
    // Programs older than `Forecast::lanes` recorded zeros.
    if a.has_lanes() != b.has_lanes() {
        return compare(&a.without_lanes(), &b.without_lanes());
    }
    let mut headers = [computed(a.header()), computed(b.header())];
    // Programs older than these counts recorded zeros.
    if headers.iter().any(|header| header.input == InputCounts::default()) {
        headers.iter_mut().for_each(|header| header.input = InputCounts::default());
    }
    let [header_a, header_b] = headers.each_ref().map(bytemuck::bytes_of);
    let is_equal =
        |(_, _, range): &(_, _, Range<usize>)| a.payload()[range.clone()] == b.payload()[range.clone()];
    let has_same_len = a.payload().len() == b.payload().len();
    if header_a == header_b && has_same_len && sections(a).iter().all(is_equal) {
        return None;
    }
    let mut found = Found { tick: a.header().seq, topic: a.topic().name, difference: None };
    found.records(&Header::RECORD, size_of::<Header>(), "header", None, [header_a, header_b]);
    let (len_a, len_b) = (a.payload().len(), b.payload().len());
    if has_same_len {
        for (record, name, range) in sections(a) {
            let payloads = [&a.payload()[range.clone()], &b.payload()[range]];
            let leading = if record.name == a.element().name { common } else { record.size };
            found.records(record, leading, name, Some(0), payloads);
        }
    } else {
        let [elements_a, elements_b] = [a, b].map(|frame| frame.elements_len() as f64);
        found.number("payload.elements_len".to_owned(), elements_a, elements_b);
        // The common elements are compared one by one: users also ask for the difference of the first
        // elements.
        if a.element().name != Row::RECORD.name {
            let len = len_a.min(len_b);
            let payloads = [&a.payload()[..len], &b.payload()[..len]];
            found.records(a.element(), common, "", Some(0), payloads);
        }
    }
    found.difference
}

/// A number of a context patch.
const CELL: Record = Record {
    name: "Cell",
    doc: "A number of a context patch.",
    size: 4,
    align: 4,
    fields: &[Field {
        name: "value",
        doc: "The number.",
        offset: 0,
        r#type: Type::Primitive(Primitive::F32),
    }],
};

/// The named parts of a payload, with one record type each. The bytes between the parts are padding of rows
/// and may belong to an earlier frame.
fn sections(frame: &Frame) -> Vec<(&'static Record, &'static str, Range<usize>)> {
    let (len, counts) = (frame.payload().len(), &frame.header().counts);
    let parts = match frame.topic().name {
        ContextTopic::NAME => {
            let shape = ContextShape::of(counts);
            let patches =
                shape.agents_len.saturating_mul(shape.history_len).saturating_mul(shape.patch_len());
            vec![
                (&Track::RECORD, "tracks", shape.agents_len.saturating_mul(size_of::<Track>())),
                (&CELL, "patches", patches.saturating_mul(CELL.size)),
            ]
        }
        FeaturesTopic::NAME => {
            let shape = FeatureShape::of(counts);
            vec![
                (
                    &AgentFeatures::RECORD,
                    "agents",
                    shape.agents_len.saturating_mul(size_of::<AgentFeatures>()),
                ),
                (&Edge::RECORD, "edges", shape.edges_len.saturating_mul(size_of::<Edge>())),
                (&Row::RECORD, "attributes", shape.edges_len.saturating_mul(size_of::<Row>())),
            ]
        }
        _ => vec![(frame.element(), "", len)],
    };
    let mut begin: usize = 0;
    let mut sections = Vec::new();
    for (record, name, bytes) in parts {
        // A header may contain any number.
        let end = begin.saturating_add(bytes).min(len);
        sections.push((record, name, begin.min(end)..end));
        begin = end.next_multiple_of(size_of::<Row>());
    }
    sections
}

/// Collects the differences of a frame.
struct Found {
    tick: u64,
    topic: &'static str,
    difference: Option<FrameDifference>,
}

impl Found {
    /// Compares the leading bytes of consecutive records. If `first` is given, the records are numbered from
    /// it.
    fn records(
        &mut self,
        record: &Record,
        leading: usize,
        name: &str,
        first: Option<usize>,
        bytes: [&[u8]; 2],
    ) {
        let mut leaves = None;
        let pairs = bytes[0].chunks_exact(leading).zip(bytes[1].chunks_exact(leading));
        for (number, (a, b)) in pairs.enumerate().filter(|(_, (a, b))| a != b) {
            let leaves: &Vec<Leaf> = leaves.get_or_insert_with(|| record.leaves());
            for leaf in leaves {
                let range = leaf.offset..leaf.offset + leaf.primitive.size();
                if range.end > leading || a[range.clone()] == b[range.clone()] {
                    continue;
                }
                let place = first.map_or_else(String::new, |first| format!("[{}]", first + number));
                let path = format!("{name}{place}.{}", leaf.path);
                self.number(path, value(leaf.primitive, &a[range.clone()]), value(leaf.primitive, &b[range]));
            }
        }
    }

    fn number(&mut self, field: String, a: f64, b: f64) {
        let difference = Difference { tick: self.tick, topic: self.topic, field, a, b };
        match &mut self.difference {
            None => {
                let farthest = difference.clone();
                self.difference = Some(FrameDifference { first: difference, farthest, numbers: 1 });
            }
            Some(known) => {
                known.numbers += 1;
                if difference.apart() > known.farthest.apart() {
                    known.farthest = difference;
                }
            }
        }
    }
}

/// A number of a payload; whole numbers beyond 2⁵³ are rounded.
fn value(primitive: Primitive, bytes: &[u8]) -> f64 {
    match primitive {
        Primitive::U8 => f64::from(bytes[0]),
        Primitive::U16 => f64::from(bytemuck::pod_read_unaligned::<u16>(bytes)),
        Primitive::U32 => f64::from(bytemuck::pod_read_unaligned::<u32>(bytes)),
        Primitive::U64 => bytemuck::pod_read_unaligned::<u64>(bytes) as f64,
        Primitive::I64 => bytemuck::pod_read_unaligned::<i64>(bytes) as f64,
        Primitive::F32 => f64::from(bytemuck::pod_read_unaligned::<f32>(bytes)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::{Detection, DetectionsTopic, context_rows};

    fn detections(xs: &[f32], seq: u64) -> Frame {
        let mut header = Header::new(1, seq, 0);
        header.counts.agents_len = xs.len() as u32;
        let each = xs.iter().map(|x_m| Detection { x_m: *x_m, ..bytemuck::Zeroable::zeroed() });
        Frame::of::<DetectionsTopic>(&header, &each.collect::<Vec<_>>(), 0)
    }

    #[test]
    fn the_first_number_and_the_farthest_are_named() {
        let found = compare(&detections(&[1.0, 2.0, 3.0], 4), &detections(&[1.0, 2.5, 9.0], 4)).unwrap();
        assert_eq!((found.first.field.as_str(), found.first.apart()), ("[1].x_m", 0.5));
        assert_eq!(
            (found.farthest.field.as_str(), found.farthest.apart(), found.numbers),
            ("[2].x_m", 6.0, 2)
        );
        assert_eq!((found.first.tick, found.first.topic), (4, "detections"));
        assert_eq!(compare(&detections(&[1.0], 4), &detections(&[1.0], 4)), None);
    }

    #[test]
    fn counts_of_the_input_are_compared_if_both_recorded_them() {
        let with = |detections: u32| {
            let mut header = *self::detections(&[], 4).header();
            header.input.detections = detections;
            Frame::of::<DetectionsTopic>(&header, &[], 0)
        };
        assert_eq!(compare(&with(0), &with(6)), None, "recorded before there were counts");
        let found = compare(&with(5), &with(6)).expect("another count");
        assert_eq!((found.first.field.as_str(), found.numbers), ("header.input.detections", 1));
    }

    #[test]
    fn places_on_lanes_are_compared_if_both_recorded_them() {
        let with = |lanes: u32| {
            let header = *self::detections(&[1.0], 4).header();
            let forecast = wire::Forecast { lanes, ..bytemuck::Zeroable::zeroed() };
            Frame::of::<wire::ForecastsTopic>(&header, &[forecast], 0)
        };
        assert_eq!(compare(&with(0), &with(2)), None, "recorded before there were places");
        let found = compare(&with(1), &with(2)).expect("another place");
        assert_eq!((found.first.field.as_str(), found.numbers), ("[0].lanes", 1));
    }

    #[test]
    fn frames_of_another_length_differ_in_it() {
        let found = compare(&detections(&[1.0], 4), &detections(&[1.0, 2.0], 4)).unwrap();
        assert_eq!(found.first.field, "header.counts.agents_len");
        assert_eq!(found.numbers, 2, "the header's count and the payload's");
    }

    #[test]
    fn clocks_runs_and_ways_do_not_count() {
        let frame = detections(&[1.0], 4);
        let mut header = *frame.header();
        (header.run_id, header.released_ns, header.incarnation) = (9, 9, 9);
        header.push_hop(Hop { sent_ns: 5, ..Hop::default() });
        let elements = frame.elements::<DetectionsTopic>().unwrap();
        assert_eq!(compare(&frame, &Frame::of::<DetectionsTopic>(&header, &elements, 7)), None);
    }

    #[test]
    fn rows_are_named_by_what_they_hold() {
        let mut header = Header::new(1, 0, 0);
        header.counts =
            wire::Counts { agents_len: 2, history_len: 2, patch_side: 4, ..wire::Counts::default() };
        let rows = context_rows(&ContextShape::of(&header.counts));
        let zeros = vec![Row::default(); rows];
        let frame = |at: usize| {
            let mut rows = zeros.clone();
            rows[at].values[0] = 1.0;
            Frame::of::<ContextTopic>(&header, &rows, 0)
        };
        let empty = Frame::of::<ContextTopic>(&header, &zeros, 0);
        let field = |at| compare(&empty, &frame(at)).unwrap().first.field;
        assert!(field(0).starts_with("tracks[0]."), "{}", field(0));
        assert_eq!(
            field(rows - 1),
            format!("patches[{}].value", 16 * (rows - 1 - 2 * size_of::<Track>() / 64))
        );
    }
}
