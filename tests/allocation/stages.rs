//! A stage allocates nothing in a steady tick, neither in its step nor in the loop around it with its waits,
//! frames and heartbeats.
//!
//! All compute stages run as threads of this process, each with its own ports, as in a lockstep run. The test
//! is the source before them and the reader after them. Allocations are counted per thread, so each count
//! belongs to one stage.
//!
//! The transport (iceoryx2 0.10.0) allocates 48 bytes for every loan, and nothing for sending, receiving,
//! notifying or waiting. Each sent frame is one loan: a tick or a heartbeat. The test measures the size of
//! this allocation by its own loan and counts allocations of that size separately. It accepts no other
//! allocations.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::process::Command;
use std::time::{Duration, Instant};

use bytemuck::Zeroable;
use nn::Precision;
use ports::{Node, Publisher, Space, StageError, Subscriber};
use run::{Run, StageRun};
use rustix::process::{Signal, getpid, kill_process};
use sampler::PropagationKind;
use testing::{AllocationCounts, CountingAllocator};
use wire::{
    AgentType, Detection, DetectionsTopic, ForecastsTopic, Header, HeartbeatsTopic, TICK_NS, Topic,
    detection_flags, flags,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Time limit for an answer, far longer than an answer takes.
const LIMIT: Duration = Duration::from_secs(60);
/// Number of the last warm-up frame; the frames before it have the number 0.
const LAST_WARM_UP: u64 = 1;
const AGENTS: u64 = 24;
/// The test's own index among the counted threads.
const HERE: usize = 7;
/// Ticks until all caches are filled. The agents need 315 ticks for a circle, and the history has 35 more. Only
/// then has every stage seen the frame with the most edges.
const WARM_UP: u64 = 360;
const TICKS: u64 = 400;
/// Names the variant that this process runs. The first process starts one process per variant.
const VARIABLE: &str = "STGDAT_ALLOCATION_VARIANT";
/// The options that change a stage's path, besides the defaults.
const VARIANTS: [&str; 5] = ["defaults", "kinematic", "jpda", "plain", "silent"];

type Body = fn(&Run) -> Result<(), StageError>;

const STAGES: [(&str, Body); 6] = [
    ("tracker", tracker::run),
    ("localiser", localiser::run),
    ("extractor", extractor::run),
    ("encoder", encoder::run),
    ("decoder", decoder::run),
    ("sampler", sampler::run),
];

/// Agents of all types, each on its own small circle.
fn detections(tick: u64) -> Vec<Detection> {
    let agent = |i: u64| {
        let turn = tick as f64 * 0.02 + i as f64;
        Detection {
            id: i + 1,
            x_m: ((i % 6) as f64 * 4.0 + turn.cos()) as f32,
            y_m: ((i / 6) as f64 * 4.0 + turn.sin()) as f32,
            heading_rad: (turn + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::TAU) as f32,
            agent_type: (i % 3) as u32,
            flags: detection_flags::HAS_ID | detection_flags::HAS_HEADING,
            ..Detection::zeroed()
        }
    };
    (0..AGENTS).map(agent).collect()
}

/// The stages' options in a variant.
fn options(variant: &str) -> Vec<StageRun> {
    let mut tracker = tracker::Options::default();
    let mut localiser = localiser::Options::default();
    let mut decoder = decoder::Options::default();
    let mut sampler = sampler::Options::default();
    match variant {
        "kinematic" => {
            tracker.prior = tracker::Prior::Kinematic;
            sampler.propagation = PropagationKind::MonteCarlo;
            sampler.evidence = false;
        }
        "jpda" => {
            (tracker.associate, tracker.association) = (true, tracker::Association::Jpda);
            tracker.frozen_frames = 0;
        }
        "plain" => {
            localiser.map = localiser::MapChoice::None;
            (sampler.retrieval, sampler.evidence) = (false, false);
            if Precision::Bf16.check().is_ok() {
                decoder.precision = Precision::Bf16;
            }
        }
        "silent" => (sampler.held_s, sampler.kinematic_s) = (0.0, Some(0.0)),
        _ => {}
    }
    vec![
        StageRun::with_options(&tracker::STAGE, &tracker).unwrap(),
        StageRun::with_options(&localiser::STAGE, &localiser).unwrap(),
        StageRun::with_options(&decoder::STAGE, &decoder).unwrap(),
        StageRun::with_options(&sampler::STAGE, &sampler).unwrap(),
    ]
}

/// The two ends of the pipeline.
struct Ends {
    run_id: u64,
    detections: Publisher<DetectionsTopic>,
    forecasts: Subscriber<ForecastsTopic>,
    heartbeats: Subscriber<HeartbeatsTopic>,
}

impl Ends {
    fn open(run: &Run) -> Self {
        let node = Node::open(run, "test").unwrap();
        Self {
            run_id: run.id,
            detections: node.publisher().unwrap(),
            forecasts: node.subscriber(ForecastsTopic::DEPTH_MAX).unwrap(),
            heartbeats: node.subscriber(HeartbeatsTopic::DEPTH_MAX).unwrap(),
        }
    }

    /// Sends warm-up frames until all stages are linked.
    fn link(&self) {
        let begin = Instant::now();
        let header = Header { flags: flags::WARM_UP | flags::LOCKSTEP, ..Header::new(self.run_id, 0, 0) };
        let mut linked = std::collections::BTreeSet::new();
        while linked.len() < STAGES.len() {
            self.detections.send_copy(&[], header).unwrap();
            std::thread::sleep(Duration::from_millis(20));
            while let Some(frame) = self.heartbeats.receive().unwrap() {
                linked.extend(frame.iter().filter(|beat| beat.linked == 1).map(|beat| beat.stage));
            }
            assert!(begin.elapsed() < LIMIT, "linked are {linked:?}");
        }
        // Warm-up frames that are still in a queue must not displace a tick: waits for the last one.
        self.detections.send_copy(&[], Header { seq: LAST_WARM_UP, ..header }).unwrap();
        while self.forecasts.receive().unwrap().is_none_or(|frame| frame.header().seq != LAST_WARM_UP) {
            assert!(begin.elapsed() < LIMIT, "the last warm-up frame does not arrive");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Passes a tick through all stages.
    fn tick(&self, tick: u64) {
        let observed_types =
            AgentType::Vehicle.bit() | AgentType::Cyclist.bit() | AgentType::Pedestrian.bit();
        let detections = detections(tick);
        let mut header = Header {
            flags: flags::LOCKSTEP | flags::HAS_IDENTITIES,
            observed_types,
            interval_ns: TICK_NS,
            ..Header::new(self.run_id, tick, (tick * TICK_NS) as i64)
        };
        header.counts.agents_len = detections.len() as u32;
        self.detections.send_copy(&detections, header).unwrap();
        let begin = Instant::now();
        loop {
            self.forecasts.sleep(Duration::from_secs(1)).unwrap();
            if let Some(frame) = self.forecasts.of_tick(tick).unwrap() {
                assert!(!frame.header().has(flags::VOID), "tick {tick} was refused");
                assert!(tick < 5 || frame.len() as u64 == AGENTS, "{} forecasts", frame.len());
                return;
            }
            assert!(begin.elapsed() < LIMIT, "no forecasts of tick {tick}");
        }
    }
}

/// Size of the one allocation that the transport makes for a loan.
fn loan_bytes(ends: &Ends) -> usize {
    let counts = AllocationCounts::during(|| drop(ends.detections.loan(1).unwrap()));
    assert_eq!(counts[HERE], [0, 1], "a loan takes one allocation");
    AllocationCounts::newest_bytes()
}

/// Ends the stages when dropped, even if the test fails.
struct Stop;

impl Drop for Stop {
    fn drop(&mut self) {
        let _ = kill_process(getpid(), Signal::TERM);
    }
}

// The only test: a second one in this process would end with the stages.
#[test]
fn the_loops_of_all_stages_allocate_nothing_in_steady_ticks() {
    if let Ok(variant) = std::env::var(VARIABLE) {
        run_variant(&variant);
        return;
    }
    for variant in VARIANTS {
        let program = std::env::current_exe().unwrap();
        let ended = Command::new(program).arg("--nocapture").env(VARIABLE, variant).status().unwrap();
        assert!(ended.success(), "{variant}: {ended}");
    }
}

fn run_variant(variant: &str) {
    let space = Space::create(None, 48 << 20).unwrap();
    let (id, prefix, root) = (space.id(), space.prefix().into(), space.root().into());
    let run = Run { id, prefix, root, lockstep: true, stages: options(variant), ..Run::default() };
    nn::Weights::onboard().config().write(&run.root).unwrap();
    std::thread::scope(|scope| {
        let run = &run;
        AllocationCounts::count_as(HERE);
        let ends = Ends::open(run);
        AllocationCounts::count_apart(loan_bytes(&ends));
        let stages = STAGES.iter().enumerate().map(|(place, (name, body))| {
            let thread = scope.spawn(move || {
                AllocationCounts::count_as(place);
                body(run)
            });
            (name, thread)
        });
        let stages: Vec<_> = stages.collect();
        let stop = Stop;
        ends.link();
        (0..WARM_UP).for_each(|tick| ends.tick(tick));
        let begin = Instant::now();
        let counts = AllocationCounts::during(|| {
            (WARM_UP..WARM_UP + TICKS).for_each(|tick| ends.tick(tick));
            // Heartbeats are part of the loop.
            std::thread::sleep(Duration::from_nanos(4 * TICK_NS));
        });
        let beats = (begin.elapsed().as_nanos() / u128::from(TICK_NS)) as usize;
        for ((name, _), [loans, others]) in STAGES.iter().zip(counts) {
            assert_eq!(others, 0, "the {name} in {TICKS} ticks and about {beats} heartbeats");
            let frames = TICKS as usize..=TICKS as usize + beats + 2;
            assert!(frames.contains(&loans), "the {name}: {loans} for {frames:?} frames");
        }
        drop(stop);
        for (name, thread) in stages {
            assert!(thread.join().unwrap().is_ok(), "{name}");
        }
    });
}
