//! The injector: a process between a topic's writer and its readers. The module also has an additional
//! consumer of a topic.

use std::path::Path;
use std::time::Duration;

use crate::checker::Line;
use ports::{AddedFrame, AddedRelay, PortError, RawFrame, Relay, Stop, monotonic_ns};
use run::{Exit, Run, TopicRun, injected_name};
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, Protection,
    TABLE, Topic, TopicEntry, TracksTopic, TruthTopic,
};

use crate::failure::Failure;
use crate::faults::effect::TopicFault;
use crate::faults::effect::{Due, Injector, Raw};
use crate::faults::follow::print;

/// Longest sleep between checks that the run is still there.
const SLEEP: Duration = Duration::from_millis(50);
/// Maximum number of frames that a consumer holds: the transport's limit per reader.
const HELD_MAX: usize = 3;

/// Calls a function with the passage of a named topic, which is built in or declared in the pipeline file.
macro_rules! with_passage {
    ($run:expr, $name:expr, $open:ident, $function:ident $(, $argument:expr)*) => {
        match $name {
            DetectionsTopic::NAME => $function(Shipped::<DetectionsTopic>::$open($run)?, $run $(, $argument)*),
            TracksTopic::NAME => $function(Shipped::<TracksTopic>::$open($run)?, $run $(, $argument)*),
            ContextTopic::NAME => $function(Shipped::<ContextTopic>::$open($run)?, $run $(, $argument)*),
            FeaturesTopic::NAME => $function(Shipped::<FeaturesTopic>::$open($run)?, $run $(, $argument)*),
            EncodingsTopic::NAME => $function(Shipped::<EncodingsTopic>::$open($run)?, $run $(, $argument)*),
            ControlsTopic::NAME => $function(Shipped::<ControlsTopic>::$open($run)?, $run $(, $argument)*),
            ForecastsTopic::NAME => $function(Shipped::<ForecastsTopic>::$open($run)?, $run $(, $argument)*),
            TruthTopic::NAME => $function(Shipped::<TruthTopic>::$open($run)?, $run $(, $argument)*),
            other => match $run.topic(other) {
                Some(topic) => $function(Declared::$open($run, topic)?, $run $(, $argument)*),
                None => Err(Failure::Usage(format!("there is no topic \"{other}\" with one writer"))),
            },
        }
    };
}

/// A connection between a topic's writer and its readers.
trait Passage {
    /// A frame in shared memory.
    type Frame;
    /// Returns the oldest frame of the queue, if any.
    fn receive(&self) -> Result<Option<Self::Frame>, PortError>;
    /// Returns a frame's content.
    fn read(frame: &Self::Frame) -> Raw;
    /// Sends a frame. Bytes after the last whole element are left out.
    fn send(&self, frame: &Raw) -> Result<(), PortError>;
    /// Keeps the topic open for writing exactly as long as its writer does.
    fn follow_writer(&self) -> Result<(), PortError>;
    /// Sleeps until a frame arrives, or for at most `timeout`.
    fn sleep(&self, timeout: Duration) -> Result<(), PortError>;
    /// The signals that ask the process to end.
    fn stop(&self) -> &Stop;
}

/// The passage of a built-in topic.
struct Shipped<T: Topic>(Relay<T>);

impl<T: Topic> Shipped<T> {
    fn between(run: &Run) -> Result<Self, PortError> {
        Relay::open(run, &injected_name(T::NAME)).map(Self)
    }

    fn consumer(run: &Run) -> Result<Self, PortError> {
        Relay::consumer(run, T::DEPTH_MAX.min(2)).map(Self)
    }
}

impl<T: Topic> Passage for Shipped<T> {
    type Frame = RawFrame<T>;

    fn receive(&self) -> Result<Option<Self::Frame>, PortError> {
        self.0.receive()
    }

    fn read(frame: &Self::Frame) -> Raw {
        let payload = bytemuck::cast_slice(frame.elements()).to_vec();
        Raw { header: *frame.header(), payload, is_lie: false }
    }

    /// Wrong content of the sender gets a matching check value.
    fn send(&self, Raw { header, payload, is_lie }: &Raw) -> Result<(), PortError> {
        let elements = payload.chunks_exact(size_of::<T::Element>()).map(bytemuck::pod_read_unaligned);
        let elements: Vec<T::Element> = elements.collect();
        let mut header = *header;
        if *is_lie && !header.protection.is_absent() {
            header.protection = Protection::of::<T>(&header, &elements, header.protection.counter);
        }
        self.0.send(&header, &elements)
    }

    fn follow_writer(&self) -> Result<(), PortError> {
        self.0.follow_writer()
    }

    fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        self.0.sleep(timeout)
    }

    fn stop(&self) -> &Stop {
        self.0.stop()
    }
}

/// The passage of a topic declared in the pipeline file; its frames have no check value.
struct Declared(AddedRelay);

impl Declared {
    fn between(run: &Run, topic: &TopicRun) -> Result<Self, PortError> {
        AddedRelay::open(run, topic, &injected_name(&topic.name)).map(Self)
    }

    fn consumer(run: &Run, topic: &TopicRun) -> Result<Self, PortError> {
        AddedRelay::consumer(run, topic).map(Self)
    }
}

impl Passage for Declared {
    type Frame = AddedFrame;

    fn receive(&self) -> Result<Option<Self::Frame>, PortError> {
        self.0.receive()
    }

    fn read(frame: &Self::Frame) -> Raw {
        Raw { header: *frame.header(), payload: frame.payload().to_vec(), is_lie: false }
    }

    fn send(&self, frame: &Raw) -> Result<(), PortError> {
        self.0.send(&frame.header, &frame.payload)
    }

    fn follow_writer(&self) -> Result<(), PortError> {
        self.0.follow_writer()
    }

    fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        self.0.sleep(timeout)
    }

    fn stop(&self) -> &Stop {
        self.0.stop()
    }
}

/// Injects the faults of a plan for one topic until the process is asked to end or the run's folder is gone.
pub fn inject(record: &Path, plan: &Path) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    let text = std::fs::read(plan).map_err(|error| Failure::file(plan, error))?;
    let faults: Vec<TopicFault> =
        serde_json::from_slice(&text).map_err(|error| Failure::file(plan, error))?;
    let topic = faults.first().map(|fault| fault.topic.clone()).unwrap_or_default();
    with_passage!(&run, topic.as_str(), between, relay, &topic, faults)
}

/// Reads a topic as an additional consumer. It holds its frames for `hold_ms`, or forever.
pub fn consume(record: &Path, topic: &str, hold_ms: Option<u64>) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    with_passage!(&run, topic, consumer, hold, hold_ms)
}

/// Returns the injector of a topic. Element fields are known only for built-in topics.
fn injector(run: &Run, topic: &str, faults: Vec<TopicFault>) -> Injector {
    let entry = |is_it: &dyn Fn(&TopicEntry) -> bool| TABLE.topics.iter().find(|entry| is_it(entry));
    if let Some(topic) = run.topic(topic) {
        let known = entry(&|entry| entry.type_name == topic.type_name);
        return Injector::new(faults, topic.element_size, known.map(|entry| entry.element));
    }
    let shipped = entry(&|entry| entry.name == topic).expect("every topic has an entry in the table");
    Injector::new(faults, shipped.element.size, Some(shipped.element))
}

fn relay<P: Passage>(passage: P, run: &Run, topic: &str, faults: Vec<TopicFault>) -> Result<Exit, Failure> {
    let mut injector = injector(run, topic, faults);
    // Frames to send, with their times.
    let mut waiting: Vec<(u64, Raw)> = Vec::new();
    let mut costs_ns = Vec::new();
    while !passage.stop().requested() && run.root.exists() {
        if waiting.is_empty() {
            // The topic must be open when a new writer sends its first frame.
            passage.follow_writer()?;
        }
        while let Some(frame) = passage.receive()? {
            let begun_ns = monotonic_ns();
            let raw = P::read(&frame);
            drop(frame);
            let (tick, is_tick) = (raw.header.seq, raw.header.is_tick());
            let (due, kinds) = injector.pass(raw);
            for Due { frame, delay_ns } in due {
                if delay_ns == 0 {
                    passage.send(&frame)?;
                } else {
                    waiting.push((begun_ns + delay_ns, frame));
                }
            }
            if is_tick {
                costs_ns.push(monotonic_ns() - begun_ns);
            }
            if !kinds.is_empty() {
                let kinds = kinds.into_iter().map(str::to_owned).collect();
                print(&Line::Injected { topic: topic.to_owned(), tick, kinds })?;
            }
        }
        waiting.sort_by_key(|(due_ns, _)| *due_ns);
        let now_ns = monotonic_ns();
        let due_len = waiting.partition_point(|(due_ns, _)| *due_ns <= now_ns);
        for (_, frame) in waiting.drain(..due_len) {
            passage.send(&frame)?;
        }
        let next = waiting.first().map(|(due_ns, _)| Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        passage.sleep(next.map_or(SLEEP, |next| next.min(SLEEP)))?;
    }
    costs_ns.sort_unstable();
    print(&Line::Cost {
        topic: topic.to_owned(),
        frames: costs_ns.len() as u64,
        us_p50: costs_ns.get(costs_ns.len() / 2).map_or(0, |ns| ns / 1_000),
        us_max: costs_ns.last().map_or(0, |ns| ns / 1_000),
    })?;
    // The launcher removes the run's files. Ports dropped after that would look for them.
    std::mem::forget(passage);
    Ok(Exit::Done)
}

fn hold<P: Passage>(passage: P, run: &Run, hold_ms: Option<u64>) -> Result<Exit, Failure> {
    let mut held = Vec::new();
    while !passage.stop().requested() && run.root.exists() {
        passage.sleep(SLEEP)?;
        if held.len() < HELD_MAX
            && let Some(frame) = passage.receive()?
        {
            held.push((monotonic_ns(), frame));
        }
        if let Some(hold_ms) = hold_ms {
            held.retain(|(since_ns, _)| monotonic_ns() - since_ns < hold_ms * 1_000_000);
        }
    }
    std::mem::forget((held, passage));
    Ok(Exit::Done)
}
