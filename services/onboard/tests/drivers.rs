//! The three places of frames give the same bytes, whatever the stages refuse: shared memory with a process per
//! stage (`run --speed max`), the memory of one process (`predict`), and a recording (`replay`).
//!
//! Faults are injected into random stages at random ticks. A faulty step refuses its tick before or after it has
//! computed, leaves the tick empty, or reads inputs with flipped bits. The source sends a VOID frame, impossible or
//! damaged detections, or a frame of another length than its header states.
//!
//! The processes are threads here, each with its own ports. `PROPTEST_CASES` sets the number of random scenes.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use data::{GeneratedScene, SceneOptions};
use decoder::Decoder;
use encoder::Encoder;
use extractor::Extractor;
use localiser::Localiser;
use nn::Weights;
use onboard::{Graph, Node, Replay, STAGES, Stages, node};
use ports::{Answer, Publisher, Second, SecondInput, Space, StageError, Step, Subscriber, Tick, drive};
use proptest::prelude::*;
use proptest::strategy::ValueTree as _;
use recording::{About, Frame, Recording, Writer, compare};
use run::{Declaration, Run};
use rustix::process::{Signal, getpid, kill_process};
use source::{Playback, PlaybackOptions};
use testing::public_recording;
use tracker::Tracker;
use wire::{
    ContextTopic, ControlsTopic, Counts, Detection, DetectionsTopic, EncodingsTopic, FeaturesTopic,
    ForecastsTopic, Header, HeartbeatsTopic, Rejected, StageId, Topic, TracksTopic, flags,
};

/// Random scenes unless `PROPTEST_CASES` states another number.
const CASES: u32 = 8;
/// Ticks of a scene. From tick 35 on, histories are full.
const TICKS: u64 = 48;
/// Time limit for a frame, far longer than a frame takes.
const LIMIT: Duration = Duration::from_secs(60);
/// Number of the last warm-up frame; the frames before it have the number 0.
const LAST_WARM_UP: u64 = 1;

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// The tick is left empty; the source sends a VOID frame.
    Empty,
    /// The tick is refused before the step has seen it; the source sends impossible detections.
    Refused,
    /// The tick is refused after the step has changed its state.
    RefusedLate,
    /// Bits of the input are flipped. The seed selects the bits.
    Damaged(u64),
    /// Bits of the second input are flipped.
    SecondDamaged(u64),
    /// The source's frame has one element too many, so its reader refuses the frame. Other stages go on.
    WrongLength,
}

#[derive(Clone, Copy, Debug)]
struct Fault {
    stage: StageId,
    seq: u64,
    kind: Kind,
}

fn faults() -> impl Strategy<Value = Vec<Fault>> {
    let kinds = prop_oneof![
        Just(Kind::Empty),
        Just(Kind::Refused),
        Just(Kind::RefusedLate),
        any::<u64>().prop_map(Kind::Damaged),
        any::<u64>().prop_map(Kind::SecondDamaged),
        Just(Kind::WrongLength),
    ];
    let stages = prop::sample::select(StageId::ALL[..7].to_vec());
    let fault = (stages, 0..TICKS, kinds).prop_map(|(stage, seq, kind)| Fault { stage, seq, kind });
    prop::collection::vec(fault, 0..12)
}

/// A step with faults.
struct Faulty<S> {
    step: S,
    stage: StageId,
    faults: Arc<[Fault]>,
}

impl<S: Step> Step for Faulty<S> {
    type Input = S::Input;
    type Second = S::Second;
    type Output = S::Output;

    const SECOND: SecondInput = S::SECOND;

    fn answer(
        &mut self,
        tick: &Tick<'_, S::Input, S::Second>,
        out: &mut Answer<'_, S::Output>,
    ) -> Result<(), Rejected> {
        let refused = Err(Rejected::Impossible { field: "seq", value: tick.header.seq as f64 });
        match fault(&self.faults, self.stage, tick.header.seq) {
            Some(Kind::Empty) => {
                out.leave_empty();
                Ok(())
            }
            Some(Kind::Refused) => refused,
            Some(Kind::RefusedLate) => self.step.answer(tick, out).and(refused),
            Some(Kind::Damaged(seed)) => {
                let input = damaged(tick.input, seed);
                let Tick { header, second, allowance, .. } = *tick;
                self.step.answer(&Tick { header, input: &input, second, allowance }, out)
            }
            Some(Kind::SecondDamaged(seed)) if let Some((of_second, elements)) = tick.second.frame() => {
                let elements = damaged(elements, seed);
                let Tick { header, input, allowance, .. } = *tick;
                let second = Second::Frame(of_second, &elements);
                self.step.answer(&Tick { header, input, second, allowance }, out)
            }
            Some(Kind::SecondDamaged(_) | Kind::WrongLength) | None => self.step.answer(tick, out),
        }
    }

    fn after(&mut self, tick: &Tick<'_, S::Input, S::Second>) {
        self.step.after(tick);
    }

    fn begin(&mut self, run: &Run, incarnation: u32) {
        self.step.begin(run, incarnation);
    }
}

/// The elements with some of their bits flipped.
fn damaged<E: bytemuck::Pod>(elements: &[E], seed: u64) -> Vec<E> {
    let mut elements = elements.to_vec();
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut elements);
    let mut place = seed;
    for _ in 0..=seed % 3 {
        // Steps of Knuth's linear congruential generator.
        place = place.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bit = (place >> 33) as usize;
        if !bytes.is_empty() {
            bytes[bit / 8 % bytes.len()] ^= 1 << (bit % 8);
        }
    }
    elements
}

fn fault(faults: &[Fault], stage: StageId, seq: u64) -> Option<Kind> {
    faults.iter().find(|fault| fault.stage == stage && fault.seq == seq).map(|fault| fault.kind)
}

/// What is done with the step of a stage.
trait Use {
    type Result;
    fn with<S: Step + Send + 'static, O>(self, declaration: &Declaration<O>, step: S) -> Self::Result;
}

/// A node of a graph in one process.
struct AsNode(Arc<[Fault]>);

impl Use for AsNode {
    type Result = Box<dyn Node>;

    fn with<S: Step + Send + 'static, O>(self, declaration: &Declaration<O>, step: S) -> Box<dyn Node> {
        node(declaration, Faulty { step, stage: declaration.id(), faults: self.0 })
    }
}

/// A process, until it is asked to end.
struct AsProcess<'a>(&'a Run, Arc<[Fault]>);

impl Use for AsProcess<'_> {
    type Result = Result<(), StageError>;

    fn with<S: Step + Send + 'static, O>(self, declaration: &Declaration<O>, step: S) -> Self::Result {
        drive(self.0, declaration, |_| Ok(Faulty { step, stage: declaration.id(), faults: self.1 }))
    }
}

fn with_step<U: Use>(stage: StageId, run: &Run, weights: &Weights, of: U) -> U::Result {
    let model = weights.config();
    match stage {
        StageId::Tracker => of.with(&tracker::STAGE, Tracker::new(tracker::settings(run, model).unwrap())),
        StageId::Localiser => {
            of.with(&localiser::STAGE, Localiser::new(localiser::settings(run, model).unwrap()))
        }
        StageId::Extractor => {
            let settings = extractor::settings(run).unwrap();
            of.with(&extractor::STAGE, Extractor::new(weights, settings).unwrap())
        }
        StageId::Encoder => {
            of.with(&encoder::STAGE, Encoder::new(weights, encoder::settings(run).unwrap()).unwrap())
        }
        StageId::Decoder => {
            of.with(&decoder::STAGE, Decoder::new(weights, decoder::settings(run).unwrap()).unwrap())
        }
        _ => of.with(&sampler::STAGE, sampler::open(run, model).unwrap()),
    }
}

/// The stages of one process.
fn nodes(run: &Run, weights: &Weights, faults: &Arc<[Fault]>) -> Vec<Box<dyn Node>> {
    // The order of a tick comes from the declarations.
    STAGES.iter().rev().map(|stage| with_step(stage.id(), run, weights, AsNode(faults.clone()))).collect()
}

/// A tick of the source.
struct SourceTick {
    header: Header,
    detections: Vec<Detection>,
    /// The frame that a process sends in place of this one. Its reader refuses it and goes on with this one.
    sent: Option<(Header, Vec<Detection>)>,
}

/// A recording as the source sends it, with the source's faults.
fn ticks(recording: &data::Recording, run: &Run, faults: &[Fault]) -> Vec<SourceTick> {
    let options = PlaybackOptions { run_id: run.id, ticks_max: Some(TICKS), lockstep: true };
    let mut playback = Playback::new(recording.clone(), options);
    let mut ticks = Vec::new();
    while let Some(tick) = playback.next_tick() {
        let (mut header, mut detections) = (tick.header, tick.detections.to_vec());
        let kind = fault(faults, StageId::Source, header.seq);
        let sent = matches!(kind, Some(Kind::WrongLength)).then(|| {
            let extra = [Detection::default()];
            (header, detections.iter().copied().chain(extra).collect())
        });
        match kind {
            None => {}
            Some(Kind::Empty | Kind::WrongLength) => {
                (header.flags, header.counts) = (header.flags | flags::VOID, Counts::default());
                detections.clear();
            }
            Some(Kind::Damaged(seed) | Kind::SecondDamaged(seed)) => detections = damaged(&detections, seed),
            Some(Kind::Refused | Kind::RefusedLate) => {
                detections.iter_mut().for_each(|detection| detection.x_m = f32::NAN);
            }
        }
        ticks.push(SourceTick { header, detections, sent });
    }
    ticks
}

/// A reader of a topic's frames.
struct Reader<T: Topic>(Subscriber<T>);

trait Reads {
    /// Waits for the frame of a tick.
    fn frame(&self, seq: u64) -> Frame;
}

impl<T: Topic> Reads for Reader<T> {
    fn frame(&self, seq: u64) -> Frame {
        let begun = std::time::Instant::now();
        loop {
            if let Some(frame) = self.0.of_tick(seq).unwrap() {
                return Frame::of::<T>(frame.header(), &frame, seq);
            }
            assert!(begun.elapsed() < LIMIT, "no {} of tick {seq}", T::NAME);
            self.0.sleep(Duration::from_secs(1)).unwrap();
        }
    }
}

/// Ends the stages when dropped, even if the test fails.
struct Stop;

impl Drop for Stop {
    fn drop(&mut self) {
        let _ = kill_process(getpid(), Signal::TERM);
    }
}

/// Sends empty frames until all stages are linked.
fn link(node: &ports::Node, detections: &Publisher<DetectionsTopic>, run_id: u64) {
    let heartbeats = node.subscriber::<HeartbeatsTopic>(HeartbeatsTopic::DEPTH_MAX).unwrap();
    let forecasts = node.subscriber::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX).unwrap();
    let begun = std::time::Instant::now();
    let header = Header { flags: flags::WARM_UP | flags::LOCKSTEP, ..Header::new(run_id, 0, 0) };
    let mut linked = std::collections::BTreeSet::new();
    while linked.len() < STAGES.len() {
        detections.send_copy(&[], header).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        while let Some(frame) = heartbeats.receive().unwrap() {
            linked.extend(frame.iter().filter(|beat| beat.linked == 1).map(|beat| beat.stage));
        }
        assert!(begun.elapsed() < LIMIT, "linked are {linked:?}");
    }
    // Warm-up frames that are still in a queue must not displace a tick: waits for the last one.
    detections.send_copy(&[], Header { seq: LAST_WARM_UP, ..header }).unwrap();
    while forecasts.receive().unwrap().is_none_or(|frame| frame.header().seq != LAST_WARM_UP) {
        assert!(begun.elapsed() < LIMIT, "the last warm-up frame does not arrive");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The frames of all topics, tick by tick, of stages with ports of their own.
fn in_processes(
    recording: &data::Recording,
    run: &Run,
    weights: &Weights,
    faults: &Arc<[Fault]>,
) -> Vec<Vec<Frame>> {
    weights.config().write(&run.root).unwrap();
    let node = ports::Node::open(run, "test").unwrap();
    let detections = node.publisher::<DetectionsTopic>().unwrap();
    let readers: [Box<dyn Reads>; 6] = [
        Box::new(Reader(node.subscriber::<TracksTopic>(2).unwrap())),
        Box::new(Reader(node.subscriber::<ContextTopic>(2).unwrap())),
        Box::new(Reader(node.subscriber::<FeaturesTopic>(2).unwrap())),
        Box::new(Reader(node.subscriber::<EncodingsTopic>(2).unwrap())),
        Box::new(Reader(node.subscriber::<ControlsTopic>(2).unwrap())),
        Box::new(Reader(node.subscriber::<ForecastsTopic>(2).unwrap())),
    ];
    std::thread::scope(|scope| {
        let serve = |stage| move || with_step(stage, run, weights, AsProcess(run, faults.clone()));
        let stages: Vec<_> = STAGES.iter().map(|stage| scope.spawn(serve(stage.id()))).collect();
        let stop = Stop;
        link(&node, &detections, run.id);
        let pass = |SourceTick { header, detections: elements, sent }: &SourceTick| {
            match sent {
                Some((header, elements)) => detections.send_copy(elements, *header).unwrap(),
                None => detections.send_copy(elements, *header).unwrap(),
            }
            let frame = Frame::of::<DetectionsTopic>(header, elements, header.seq);
            std::iter::once(frame).chain(readers.iter().map(|reader| reader.frame(header.seq))).collect()
        };
        let frames = ticks(recording, run, faults).iter().map(pass).collect();
        drop(stop);
        stages.into_iter().for_each(|stage| stage.join().unwrap().unwrap());
        frames
    })
}

fn of<T: Topic>(graph: &Graph, seq: u64) -> Frame {
    let frame = graph.shared::<T>().unwrap_or_else(|| panic!("no {} of tick {seq}", T::NAME));
    Frame::of::<T>(&frame.header, &frame.elements, seq)
}

/// The frames of all topics, tick by tick, of stages in one process.
fn in_one_process(
    recording: &data::Recording,
    run: &Run,
    weights: &Weights,
    faults: &Arc<[Fault]>,
) -> Vec<Vec<Frame>> {
    let mut graph = Graph::new(nodes(run, weights, faults));
    graph.begin(run, 0);
    let pass = |SourceTick { header, detections, .. }: &SourceTick| {
        graph.put::<DetectionsTopic>(header, detections);
        graph.tick(|_| ());
        let seq = header.seq;
        let (graph, sent) = (&graph, Frame::of::<DetectionsTopic>(header, detections, seq));
        let before = [sent, of::<TracksTopic>(graph, seq), of::<ContextTopic>(graph, seq)];
        let after = [
            of::<FeaturesTopic>(graph, seq),
            of::<EncodingsTopic>(graph, seq),
            of::<ControlsTopic>(graph, seq),
            of::<ForecastsTopic>(graph, seq),
        ];
        before.into_iter().chain(after).collect()
    };
    ticks(recording, run, faults).iter().map(pass).collect()
}

/// Writes frames as a recording of a run.
fn record(path: &Path, run: &Run, frames: &[Vec<Frame>]) -> Recording {
    let topics = frames[0].iter().map(|frame| frame.topic().name.to_owned()).collect();
    let about = About { run: run.clone(), topics, ..About::default() };
    let mut writer = Writer::create(path, &about, "{\"schema\":2}").unwrap();
    frames.iter().flatten().for_each(|frame| writer.frame(frame));
    writer.finish("done").unwrap();
    Recording::open(path).unwrap()
}

/// Fails if one of the three places gives other bytes.
fn check(recording: &data::Recording, faults: Vec<Fault>) {
    /// The stages end at a signal, which all runs of this process receive.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let faults: Arc<[Fault]> = faults.into();
    let weights = Weights::onboard();
    let space = Space::create(None, 48 << 20).unwrap();
    let (id, prefix, root) = (space.id(), space.prefix().into(), space.root().into());
    let run = Run { id, prefix, root, lockstep: true, interval_ns: recording.interval_ns, ..Run::default() };

    let processes = in_processes(recording, &run, &weights, &faults);
    let one = in_one_process(recording, &run, &weights, &faults);
    assert!(processes.len() == one.len() && !one.is_empty());
    for (a, b) in processes.iter().flatten().zip(one.iter().flatten()) {
        let difference = compare(a, b);
        assert!(difference.is_none(), "processes and one process: {difference:?} with {faults:?}");
    }
    let path = run.root.join("recorded.mcap");
    let recorded = record(&path, &run, &processes);
    let stages = Stages::of(nodes(&run, &weights, &faults), &run, weights);
    let replayed = Replay::over(&recorded, stages, None).unwrap().run(|_| ()).unwrap();
    assert!(replayed.comparison.is_equal(), "the replay: {:?} with {faults:?}", replayed.comparison);
    assert_eq!((replayed.ticks, replayed.comparison.ticks()), (one.len() as u64, one.len() as u64));
}

/// The number of random scenes.
fn cases() -> u32 {
    std::env::var("PROPTEST_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(CASES)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), max_shrink_iters: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_scenes_with_faults_have_the_same_bytes_everywhere(
        seed: u64, agents in 1_usize..10, identities: bool, faults in faults()
    ) {
        let scene = GeneratedScene::new(SceneOptions { agents, seed, identities, ..SceneOptions::default() });
        check(&scene.unwrap().recording(TICKS as usize), faults);
    }
}

#[test]
fn recordings_with_faults_have_the_same_bytes_everywhere() {
    let mut random = proptest::test_runner::TestRunner::deterministic();
    for name in [
        "eth_ucy/raw/biwi_eth.txt",
        "interaction/recorded_trackfiles/DR_USA_Roundabout_SR/vehicle_tracks_000.csv",
        "vci_dut/intersection_01_traj_ped_filtered.csv",
        "kitti_tracking/label/0000.txt",
        "sdd/trajnet/train/gates_1.txt",
        "driving/apolloscape/result_9048_1.csv",
        "driving/av2_sensor/3b3570b4-7b0b-3268-a571-b0889dbf40b6.csv",
        "driving/mona/MONAEast_0000-2399.csv",
        "driving/ngsim_lankershim/USA_Lanker-2_10_T-1.csv",
        "driving/ngsim_peachtree/USA_Peach-2_1_T-1.csv",
        "driving/ngsim_us101/USA_US101-10_1_T-1.csv",
        "driving/nuscenes_mini/scene-0061.csv",
        "driving/womd/tfrecord-00001-of-01000_307.csv",
    ] {
        let Some(path) = public_recording(name) else { continue };
        let recording = data::open(&path, None).unwrap();
        let faults = faults().new_tree(&mut random).unwrap().current();
        check(&recording, faults);
    }
}
