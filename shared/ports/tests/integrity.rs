//! Tests the frames that a reader refuses, their causes, and the ticks that are declared lost.

use bytemuck::{bytes_of, cast_slice};
use ports::{Awaited, Node, Relay, Space, Stage, Subscriber, monotonic_ns};
use run::{Declaration, NoOptions, Run};
use wire::{
    Detection, DetectionsTopic, Forecast, ForecastsTopic, Header, Hop, Primitive, Protection, RefusalCause,
    Rejected, StageId, TABLE, Topic, Track, TracksTopic, flags,
};

use crate::topic;

/// A reader of tracks and forecasts, and a stage that passes tracks on.
const READER: Declaration<NoOptions> =
    Declaration::new(StageId::Tracker, &[DetectionsTopic::NAME, ForecastsTopic::NAME], &[TracksTopic::NAME]);
const RECORDER: Declaration<NoOptions> = Declaration::new(StageId::Recorder, &[ForecastsTopic::NAME], &[]);
/// Bits that are flipped in each mode, as in the documentation.
const FLIPS: u64 = 10_000;

fn run(lockstep: bool, protected: &[&str]) -> (Space, Run) {
    let (space, run) = crate::run();
    let protected = protected.iter().map(|&name| name.to_owned()).collect();
    (space, Run { lockstep, protected, interval_ns: 80_000_000, ..run })
}

/// The header of a tick as the sampler sends it.
fn header(run: &Run, seq: u64, len: usize) -> Header {
    let mut header = Header::new(run.id, seq, seq as i64 * 80_000_000);
    (header.sender, header.interval_ns, header.counts.agents_len) =
        (StageId::Sampler.number(), 80_000_000, len as u32);
    header.push_hop(Hop { stage: header.sender, ..Hop::default() });
    header
}

fn protected<T: Topic>(header: Header, elements: &[T::Element], counter: u32) -> Header {
    Header { protection: Protection::of::<T>(&header, elements, counter), ..header }
}

fn cause_of<T: Topic>(stage: &Stage, reader: &Subscriber<T>) -> Vec<(StageId, RefusalCause, u32)> {
    assert!(reader.receive().expect("the topic is open").is_none(), "it is refused");
    let refusals = stage.heartbeat().refusals.into_iter().filter(|refusal| refusal.cause > 0);
    let told = refusals.map(|refusal| {
        let cause = RefusalCause::from_number(u32::from(refusal.cause)).expect("a known cause");
        (StageId::from_number(u32::from(refusal.sender)).expect("a known stage"), cause, refusal.frames_len)
    });
    told.collect()
}

#[test]
fn a_flipped_bit_is_a_wrong_check_value_wherever_it_lies() {
    let (_space, run) = run(false, &[ForecastsTopic::NAME]);
    let mut stage = Stage::open(&run, &READER).unwrap();
    let reader = stage.subscribe_feedback::<ForecastsTopic>(2).unwrap();
    let relay = Relay::open(&run, topic::<ForecastsTopic>(&run), "raw").unwrap();
    relay.send(&protected::<ForecastsTopic>(header(&run, 0, 0), &[], 0), &[]).unwrap();
    assert!(reader.receive().unwrap().is_some());
    let good = protected::<ForecastsTopic>(header(&run, 1, 0), &[], 1);
    let flipped = [
        Header { run_id: good.run_id ^ 2, ..good },
        Header { incarnation: good.incarnation ^ 4, ..good },
        Header { sender: StageId::Decoder.number(), ..good },
        Header { seq: good.seq ^ 1, ..good },
        Header { counts: wire::Counts { agents_len: 1 << 20, ..good.counts }, ..good },
    ];
    for frame in &flipped {
        relay.send(frame, &[]).unwrap();
        let _ = reader.receive().unwrap();
    }
    let all = flipped.len() as u32;
    assert_eq!(cause_of(&stage, &reader), [(StageId::Sampler, RefusalCause::CheckValue, all)]);
    relay.send(&good, &[]).unwrap();
    assert!(reader.receive().unwrap().is_some(), "the frame as it was sent");
}

#[test]
fn a_lie_with_its_check_value_is_refused_for_what_it_says() {
    let (_space, run) = run(false, &[ForecastsTopic::NAME]);
    let mut stage = Stage::open(&run, &READER).unwrap();
    let reader = stage.subscribe_feedback::<ForecastsTopic>(2).unwrap();
    let relay = Relay::open(&run, topic::<ForecastsTopic>(&run), "raw").unwrap();
    let foreign = Header { run_id: run.id ^ 1, ..header(&run, 0, 0) };
    relay.send(&protected::<ForecastsTopic>(foreign, &[], 0), &[]).unwrap();
    assert_eq!(cause_of(&stage, &reader), [(StageId::Sampler, RefusalCause::ForeignRun, 1)]);
    let other = Header { schema: 99, ..header(&run, 0, 0) };
    relay.send(&other, &[]).unwrap();
    assert_eq!(cause_of(&stage, &reader)[1], (StageId::Sampler, RefusalCause::Schema, 1));
}

#[test]
fn in_lockstep_a_refused_tick_goes_on_as_void_and_comes_once() {
    let (_space, run) = run(true, &[]);
    let mut stage = Stage::open(&run, &READER).unwrap();
    let input = stage.subscribe::<DetectionsTopic>().unwrap();
    let forecasts = stage.subscribe_feedback::<ForecastsTopic>(2).unwrap();
    let _output = stage.publish::<TracksTopic>().unwrap();
    let relay = Relay::open(&run, topic::<DetectionsTopic>(&run), "raw").unwrap();
    let soon = || Some(monotonic_ns() + 1_000_000);
    let tick = |seq| Header { flags: flags::LOCKSTEP, ..header(&run, seq, 0) };
    // The header states another length.
    let refused = |seq| relay.send(&tick(seq), bytes_of(&Detection::default())).unwrap();
    let lost = |stage: &mut Stage| match stage.next_until(&input, soon()).unwrap() {
        Awaited::Lost(header) => header,
        other => panic!("{other:?}"),
    };

    relay.send(&tick(0), &[]).unwrap();
    assert!(matches!(stage.next_until(&input, soon()).unwrap(), Awaited::Frame(_)));
    refused(1);
    let passed = lost(&mut stage);
    assert!(passed.has(flags::VOID | flags::LOCKSTEP), "nobody waits for it");
    assert_eq!((passed.seq, passed.stamp_ns), (1, 80_000_000));
    relay.send(&tick(1), &[]).unwrap();
    assert!(matches!(stage.next_until(&input, soon()).unwrap(), Awaited::Late), "it is lost");
    // The header is not credible: the frame counts as the expected tick.
    relay.send(&Header { schema: 99, seq: 77, ..tick(2) }, &[]).unwrap();
    let passed = lost(&mut stage);
    assert_eq!((passed.seq, passed.stamp_ns), (2, 160_000_000), "the one that is due");
    relay.send(&tick(3), &[]).unwrap();
    assert!(matches!(stage.next_until(&input, soon()).unwrap(), Awaited::Frame(_)));
    assert_eq!(stage.heartbeat().dropped_len, 0);

    let back = Relay::open(&run, topic::<ForecastsTopic>(&run), "back").unwrap();
    back.send(&tick(0), &[]).unwrap();
    assert!(matches!(stage.wait_for(&forecasts, 0, soon()).unwrap(), Awaited::Frame(_)));
    back.send(&tick(1), bytes_of(&Forecast::default())).unwrap();
    assert!(matches!(stage.wait_for(&forecasts, 1, soon()).unwrap(), Awaited::Lost(_)));
}

#[test]
fn a_flipped_incarnation_makes_no_reader_deaf() {
    let (_space, run) = run(false, &[]);
    let mut stage = Stage::open(&run, &RECORDER).unwrap();
    let input = stage.subscribe::<ForecastsTopic>().unwrap();
    let relay = Relay::open(&run, topic::<ForecastsTopic>(&run), "raw").unwrap();
    relay.send(&Header { incarnation: 1 << 20, ..header(&run, 0, 0) }, &[]).unwrap();
    assert!(input.receive().unwrap().is_some(), "it can't be told from a restarted sender");
    let taken = (1..40).filter(|&seq| {
        relay.send(&header(&run, seq, 0), &[]).unwrap();
        input.receive().unwrap().is_some()
    });
    assert_eq!(taken.count(), 39 - 16, "a dead process has left no more");
}

#[test]
fn in_real_time_a_refused_tick_is_merely_missing() {
    let (_space, run) = run(false, &[]);
    let mut stage = Stage::open(&run, &RECORDER).unwrap();
    let input = stage.subscribe_deep::<ForecastsTopic>(8).unwrap();
    let relay = Relay::open(&run, topic::<ForecastsTopic>(&run), "raw").unwrap();
    for (seq, len) in [(0, 0), (1, 1), (2, 0)] {
        relay.send(&header(&run, seq, 0), cast_slice(&vec![Forecast::default(); len])).unwrap();
    }
    assert!(matches!(stage.wait_for(&input, 0, Some(0)).unwrap(), Awaited::Frame(_)));
    assert!(matches!(stage.wait_for(&input, 1, Some(0)).unwrap(), Awaited::Late));
    assert!(matches!(stage.wait_for(&input, 2, Some(0)).unwrap(), Awaited::Frame(_)));
}

/// The tracks under another name.
#[derive(Debug)]
enum RawTracks {}

impl Topic for RawTracks {
    type Element = Track;
    const NAME: &'static str = "raw";
    const DOC: &'static str = TracksTopic::DOC;
    const TYPE_NAME: &'static str = TracksTopic::TYPE_NAME;
    const ELEMENTS_MAX: usize = TracksTopic::ELEMENTS_MAX;
    const ELEMENTS_START: usize = TracksTopic::ELEMENTS_START;
    const SUBSCRIBERS_MAX: usize = TracksTopic::SUBSCRIBERS_MAX;
    const DEPTH_MAX: usize = TracksTopic::DEPTH_MAX;
}

#[test]
fn a_relay_shows_its_readers_the_end_of_the_writer() {
    let (_space, run) = run(false, &[]);
    let reader = Node::open(&run, "reader").unwrap().subscriber::<TracksTopic>(2).unwrap();
    let relay = Relay::open(&run, topic::<TracksTopic>(&run), "raw").unwrap();
    let tool = Node::open(&run, "tool").unwrap();
    relay.follow_writer().unwrap();
    assert!(!reader.has_no_publisher(), "open until the first writer has come");
    for seq in 0..2 {
        let writer = tool.publisher::<RawTracks>().unwrap();
        relay.follow_writer().unwrap();
        writer.send_copy(&[], header(&run, seq, 0)).unwrap();
        let frame = relay.receive().unwrap().expect("the frame is in the queue");
        relay.send(frame.header(), frame.payload()).unwrap();
        assert_eq!(reader.receive().unwrap().expect("it is passed on").header().seq, seq);
        drop((frame, writer));
        relay.follow_writer().unwrap();
        assert!(reader.has_no_publisher(), "its writer has ended");
    }
}

/// Flips one bit in each of many frames, anywhere in header and payload. Returns the number of frames that
/// the reader accepts and whose elements pass the checks that every stage makes. Accepted frames have finite
/// numbers.
fn taken<T: Topic>(
    protected_topics: &[&str],
    good: &[T::Element],
    sender: StageId,
    check: fn(&T::Element) -> Result<(), Rejected>,
) -> u64 {
    let (_space, run) = run(false, protected_topics);
    let reader = Node::open(&run, "reader")
        .expect("the test makes a run")
        .subscriber::<T>(2)
        .expect("the test makes a run");
    let relay = Relay::open(&run, topic::<T>(&run), "raw").expect("the test makes a run");
    let record =
        TABLE.topics.iter().find(|topic| topic.name == T::NAME).expect("the test makes a run").element;
    let reals: Vec<usize> = record
        .leaves()
        .into_iter()
        .filter(|leaf| leaf.primitive == Primitive::F32)
        .map(|leaf| leaf.offset)
        .collect();
    let is_finite = |element: &T::Element| {
        let bytes = bytemuck::bytes_of(element);
        reals.iter().all(|&at| f32::from_le_bytes([0, 1, 2, 3].map(|byte| bytes[at + byte])).is_finite())
    };
    let (mut taken, mut state) = (0, 1_u64);
    for flip in 0..FLIPS {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        let plain = Header { sender: sender.number(), ..header(&run, flip, good.len()) };
        let is_protected = !protected_topics.is_empty();
        let mut sent = if is_protected { protected::<T>(plain, good, flip as u32) } else { plain };
        let mut elements = good.to_vec();
        let (head, body) = (8 * size_of::<Header>(), 8 * size_of_val(good));
        let bit = (state % (head + body) as u64) as usize;
        let (bytes, bit) = if bit < head {
            (bytemuck::bytes_of_mut(&mut sent), bit)
        } else {
            (bytemuck::cast_slice_mut(&mut elements), bit - head)
        };
        bytes[bit / 8] ^= 1 << (bit % 8);
        relay.send(&sent, cast_slice(&elements)).expect("a good frame");
        if let Some(frame) = reader.receive().expect("a good frame")
            && frame.iter().all(|element| check(element).is_ok())
        {
            taken += 1;
            assert!(frame.iter().all(is_finite), "flip {flip}");
        }
    }
    taken
}

fn detection() -> Detection {
    Detection { x_m: 3.0, y_m: 5.0, speed_mps: 2.0, sigma_m: 0.1, ..Detection::default() }
}

#[test]
fn with_the_check_on_no_flipped_bit_passes() {
    let topics = [DetectionsTopic::NAME, TracksTopic::NAME, ForecastsTopic::NAME];
    let (detections, tracks) = ([detection(); 8], [Track::default(); 2]);
    assert_eq!(taken::<DetectionsTopic>(&topics, &detections, StageId::Source, Detection::check), 0);
    assert_eq!(taken::<TracksTopic>(&topics, &tracks, StageId::Tracker, Track::check), 0);
    assert_eq!(
        taken::<ForecastsTopic>(&topics, &[Forecast::default()], StageId::Sampler, Forecast::check),
        0
    );
}

#[test]
fn with_the_check_off_what_passes_is_finite_and_possible() {
    let (detections, tracks) = ([detection(); 8], [Track::default(); 2]);
    let passed = [
        taken::<DetectionsTopic>(&[], &detections, StageId::Source, Detection::check),
        taken::<TracksTopic>(&[], &tracks, StageId::Tracker, Track::check),
        taken::<ForecastsTopic>(&[], &[Forecast::default()], StageId::Sampler, Forecast::check),
    ];
    println!(
        "of {FLIPS} flipped bits each, without a check value, pass in detections, tracks, forecasts: {passed:?}"
    );
    assert!(passed.iter().all(|passed| (1..FLIPS).contains(passed)), "{passed:?}");
}
