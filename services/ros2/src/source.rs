//! The source of a run whose detections come from ROS.

use std::sync::Arc;
use std::time::{Duration, Instant};

use data::formats::rosbag::Object;
use interop::messages::{DetectedObjects, TfMessage, TrackedObjects};
use ports::{Stage, StageError, monotonic_ns};
use run::{Declaration, Run};
use source::Outputs;
use wire::{Counts, DetectionsTopic, Header, StageId, StampSource, Topic as _, TruthTopic, flags};

use crate::inbox::Inbox;
use crate::node::{Node, NodeError, latched, reliable};
use crate::options::{Options, names};
use crate::ticks::{Message, Tick, Ticks, World};

/// The stage that this program replaces.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME])
        .with_rule(Options::check);

/// Messages that wait for the stage, transforms included.
const INBOX_MAX: usize = 1024;
/// Longest wait for a message, so that waiting ones go out in time.
const WAIT: Duration = Duration::from_millis(10);
/// Longest wait for the stages to link, and for the forecasts of a tick in lockstep.
const ANSWER_LIMIT_NS: u64 = 60_000_000_000;
/// Longest wait for the last tick to pass, and then for the end frame to reach the stages.
const END_LIMIT_NS: u64 = 2_000_000_000;
/// Time between two reports of problems.
const REPORT: Duration = Duration::from_secs(5);
/// Queues of subscriptions: as tf2 has them, and as Autoware's subscribers of objects.
const TRANSFORMS_DEPTH: usize = 100;
const OBJECTS_DEPTH: usize = 1;

/// What arrives from ROS.
#[derive(Debug)]
enum Arrival {
    Objects(Message),
    Transforms(TfMessage, bool),
}

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] if an option, DDS or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let mut stage = Stage::open(run, &STAGE)?;
    let mut outputs = Outputs::open(&mut stage, run)?;
    let inbox = Arc::new(Inbox::new(INBOX_MAX));
    let node = subscribe(&options, &inbox)?;
    let world = World { frame: options.frame.clone(), origin: run.origin(), pose: options.pose };
    let mut source = Source {
        ticks: Ticks::new(world),
        seq: 0,
        stamp_ns: 0,
        interval_ns: run.interval_ns,
        base: base(run, &options),
        reported: Instant::now(),
    };
    let warm_up = source.empty(flags::WARM_UP);
    if stage.incarnation() > 0 {
        source.seq = outputs.take_over(&mut stage, warm_up)?.map_or(0, |seq| seq + 1);
    } else {
        outputs.repeat(&mut stage, warm_up, ANSWER_LIMIT_NS, |peers| peers.unlinked().is_empty())?;
    }
    // Objects that arrived before are no longer new.
    for arrival in inbox.take(Duration::ZERO) {
        if let Arrival::Transforms(message, is_static) = arrival {
            source.ticks.transform(&message, is_static);
        }
    }
    let is_last = |source: &Source| options.ticks.is_some_and(|ticks| source.seq >= ticks);
    while !stage.stop().requested() && !is_last(&source) {
        outputs.tend(&mut stage)?;
        for arrival in inbox.take(WAIT) {
            match arrival {
                Arrival::Objects(message) => source.ticks.message(message),
                Arrival::Transforms(message, is_static) => source.ticks.transform(&message, is_static),
            }
        }
        while !is_last(&source)
            && let Some(tick) = source.ticks.next(monotonic_ns())
        {
            source.send(&mut stage, &mut outputs, &tick, run.lockstep)?;
        }
        source.report(&inbox);
    }
    drop(node);
    inbox.close();
    tracing::info!("{}", source.ticks.counts());
    if stage.stop().requested() {
        return Ok(());
    }
    // The end frame must not push the last tick out of a queue.
    let end = source.empty(flags::END);
    let _ = outputs.wait_for_forecasts(&mut stage, source.seq.saturating_sub(1), END_LIMIT_NS);
    let _ = outputs.repeat(&mut stage, end, END_LIMIT_NS, |_| false);
    Ok(())
}

/// The state between two ticks.
struct Source {
    ticks: Ticks,
    /// Number of the next tick.
    seq: u64,
    /// Stamp and interval of the previous tick.
    stamp_ns: i64,
    interval_ns: u64,
    base: Header,
    reported: Instant,
}

/// What all headers have in common.
fn base(run: &Run, options: &Options) -> Header {
    // Detections have no identities, and one without makes all untrustworthy.
    let has_identities = options.detections().is_empty() && !options.tracks.is_empty();
    let identities = if has_identities { flags::HAS_IDENTITIES } else { 0 };
    let lockstep = if run.lockstep { flags::LOCKSTEP } else { 0 };
    Header {
        flags: identities | lockstep,
        stamp_source: StampSource::SensorClock as u32,
        ..Header::new(run.id, 0, 0)
    }
}

impl Source {
    /// The header of a frame without detections. The end follows the last tick by an interval.
    fn empty(&self, flags: u32) -> Header {
        Header {
            flags: self.base.flags | flags,
            seq: self.seq,
            stamp_ns: self.stamp_ns.saturating_add_unsigned(self.interval_ns),
            interval_ns: self.interval_ns,
            ..self.base
        }
    }

    fn send(
        &mut self,
        stage: &mut Stage,
        outputs: &mut Outputs,
        tick: &Tick,
        is_lockstep: bool,
    ) -> Result<(), StageError> {
        let frame = &tick.frame;
        let from_ego = if frame.ego.is_sensor { flags::SEEN_FROM_EGO } else { 0 };
        let header = Header {
            flags: self.base.flags | from_ego,
            seq: self.seq,
            stamp_ns: frame.stamp_ns,
            interval_ns: tick.interval_ns,
            observed_types: frame.observed_types,
            ego_m: frame.ego.position_m,
            ego_heading_rad: frame.ego.heading_rad,
            left_out_len: tick.left_out,
            input: tick.input,
            counts: Counts { agents_len: frame.detections.len() as u32, ..Counts::default() },
            ..self.base
        };
        let tick = source::Tick { header, detections: &frame.detections, truth: &[], due_ns: 0 };
        outputs.send(stage, &tick)?;
        if is_lockstep {
            outputs.wait_for_forecasts(stage, self.seq, ANSWER_LIMIT_NS)?;
        }
        self.seq += 1;
        (self.stamp_ns, self.interval_ns) = (header.stamp_ns, header.interval_ns);
        Ok(())
    }

    /// Logs the newest problem, at most once in [`REPORT`].
    fn report(&mut self, inbox: &Inbox<Arrival>) {
        if self.reported.elapsed() >= REPORT
            && let Some(problem) = self.ticks.take_problem()
        {
            self.reported = Instant::now();
            let (counts, dropped) = (self.ticks.counts(), inbox.dropped());
            tracing::warn!("{problem}; so far {counts}; {dropped} dropped before they were read");
        }
    }
}

/// Opens the subscriptions, whose threads fill the inbox.
fn subscribe(options: &Options, inbox: &Arc<Inbox<Arrival>>) -> Result<Node, NodeError> {
    let mut node = Node::open(options, "source")?;
    let qos = reliable(OBJECTS_DEPTH);
    let qos = if options.best_effort { qos.reliability_best_effort() } else { qos };
    let detections = options.detections();
    for name in &detections {
        let inbox = Arc::clone(inbox);
        let take = move |DetectedObjects { header, objects }: DetectedObjects| {
            let objects = objects.into_iter().map(Object::from).collect();
            inbox.push(Arrival::Objects(Message { header, objects, arrived_ns: monotonic_ns() }))
        };
        node.read(options.topic(name), &DetectedObjects::DEFINITION, &qos, take)?;
    }
    for name in &options.tracks {
        let inbox = Arc::clone(inbox);
        let take = move |TrackedObjects { header, objects }: TrackedObjects| {
            let objects = objects.into_iter().map(Object::from).collect();
            inbox.push(Arrival::Objects(Message { header, objects, arrived_ns: monotonic_ns() }))
        };
        node.read(options.topic(name), &TrackedObjects::DEFINITION, &qos, take)?;
    }
    for (name, qos, is_static) in
        [(names::TF, reliable(TRANSFORMS_DEPTH), false), (names::TF_STATIC, latched(TRANSFORMS_DEPTH), true)]
    {
        let inbox = Arc::clone(inbox);
        let take = move |message: TfMessage| inbox.push(Arrival::Transforms(message, is_static));
        node.read(options.topic(name), &TfMessage::DEFINITION, &qos, take)?;
    }
    let read: Vec<&str> = detections.iter().chain(&options.tracks).map(|name| options.topic(name)).collect();
    tracing::info!("reads {}", read.join(", "));
    Ok(node)
}
