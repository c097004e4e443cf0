//! The injector: a process between a topic's writer and its readers, or one more consumer of a topic.

use std::path::Path;
use std::time::Duration;

use checker::Line;
use ports::{Relay, monotonic_ns};
use run::{Exit, Run};
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, Protection,
    Record, TABLE, Topic, TracksTopic, TruthTopic,
};

use crate::failure::Failure;
use crate::faults::effect::{Due, Injector, Raw};
use crate::faults::follow::print;
use crate::faults::raw_name;
use crate::faults::spec::TopicFault;

/// Longest sleep, after which it looks whether the run is still there.
const SLEEP: Duration = Duration::from_millis(50);
/// Frames that a consumer holds at most: all that the transport allows a reader.
const HELD_MAX: usize = 3;

/// Calls a function for the topic of a name.
macro_rules! with_topic {
    ($name:expr, $function:ident, $($argument:expr),*) => {
        match $name {
            DetectionsTopic::NAME => $function::<DetectionsTopic>($($argument),*),
            TracksTopic::NAME => $function::<TracksTopic>($($argument),*),
            ContextTopic::NAME => $function::<ContextTopic>($($argument),*),
            FeaturesTopic::NAME => $function::<FeaturesTopic>($($argument),*),
            EncodingsTopic::NAME => $function::<EncodingsTopic>($($argument),*),
            ControlsTopic::NAME => $function::<ControlsTopic>($($argument),*),
            ForecastsTopic::NAME => $function::<ForecastsTopic>($($argument),*),
            TruthTopic::NAME => $function::<TruthTopic>($($argument),*),
            other => Err(Failure::Usage(format!("there is no topic \"{other}\" with one writer"))),
        }
    };
}

/// Injects the faults of a plan, all of one topic, until it is asked to end or the run's folder is gone.
pub fn inject(record: &Path, plan: &Path) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    let text = std::fs::read(plan).map_err(|error| Failure::file(plan, error))?;
    let faults: Vec<TopicFault> =
        serde_json::from_slice(&text).map_err(|error| Failure::file(plan, error))?;
    let topic = faults.first().map(|fault| fault.topic.clone()).unwrap_or_default();
    with_topic!(topic.as_str(), relay, &run, faults)
}

/// Reads a topic as one more consumer, which holds what it reads for a time or for ever.
pub fn consume(record: &Path, topic: &str, hold_ms: Option<u64>) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    with_topic!(topic, hold, &run, hold_ms)
}

/// The record of a topic's elements.
fn element(topic: &str) -> &'static Record {
    let entry = TABLE.topics.iter().find(|entry| entry.name == topic);
    entry.expect("every topic has an entry in the table").element
}

fn relay<T: Topic>(run: &Run, faults: Vec<TopicFault>) -> Result<Exit, Failure> {
    let relay = Relay::<T>::open(run, &raw_name(T::NAME))?;
    let mut injector = Injector::new(faults, element(T::NAME));
    // What is to be sent, and when.
    let mut waiting: Vec<(u64, Raw)> = Vec::new();
    let mut costs_ns = Vec::new();
    while !relay.stop().requested() && run.root.exists() {
        if waiting.is_empty() {
            // A new writer's first frame must find the topic open.
            relay.follow_writer()?;
        }
        while let Some(frame) = relay.receive()? {
            let begun_ns = monotonic_ns();
            let payload = bytemuck::cast_slice(frame.elements()).to_vec();
            let raw = Raw { header: *frame.header(), payload, is_lie: false };
            drop(frame);
            let (tick, is_tick) = (raw.header.seq, raw.header.is_tick());
            let (due, kinds) = injector.pass(raw);
            for Due { frame, delay_ns } in due {
                if delay_ns == 0 {
                    send(&relay, &frame)?;
                } else {
                    waiting.push((begun_ns + delay_ns, frame));
                }
            }
            if is_tick {
                costs_ns.push(monotonic_ns() - begun_ns);
            }
            if !kinds.is_empty() {
                let kinds = kinds.into_iter().map(str::to_owned).collect();
                print(&Line::Injected { topic: T::NAME.to_owned(), tick, kinds })?;
            }
        }
        waiting.sort_by_key(|(due_ns, _)| *due_ns);
        let now_ns = monotonic_ns();
        let due_len = waiting.partition_point(|(due_ns, _)| *due_ns <= now_ns);
        for (_, frame) in waiting.drain(..due_len) {
            send(&relay, &frame)?;
        }
        let next = waiting.first().map(|(due_ns, _)| Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        relay.sleep(next.map_or(SLEEP, |next| next.min(SLEEP)))?;
    }
    costs_ns.sort_unstable();
    print(&Line::Cost {
        topic: T::NAME.to_owned(),
        frames: costs_ns.len() as u64,
        us_p50: costs_ns.get(costs_ns.len() / 2).map_or(0, |ns| ns / 1_000),
        us_max: costs_ns.last().map_or(0, |ns| ns / 1_000),
    })?;
    // The launcher removes the run's files; ports that end after it would look for theirs.
    std::mem::forget(relay);
    Ok(Exit::Done)
}

/// Sends the elements; bytes beyond the last whole one are left out. A lie has the check value of what it says.
fn send<T: Topic>(relay: &Relay<T>, Raw { header, payload, is_lie }: &Raw) -> Result<(), Failure> {
    let elements = payload.chunks_exact(size_of::<T::Element>()).map(bytemuck::pod_read_unaligned);
    let elements: Vec<T::Element> = elements.collect();
    let mut header = *header;
    if *is_lie && !header.protection.is_absent() {
        header.protection = Protection::of::<T>(&header, &elements, header.protection.counter);
    }
    Ok(relay.send(&header, &elements)?)
}

fn hold<T: Topic>(run: &Run, hold_ms: Option<u64>) -> Result<Exit, Failure> {
    let relay = Relay::<T>::consumer(run, T::DEPTH_MAX.min(2))?;
    let mut held = Vec::new();
    while !relay.stop().requested() && run.root.exists() {
        relay.sleep(SLEEP)?;
        if held.len() < HELD_MAX
            && let Some(frame) = relay.receive()?
        {
            held.push((monotonic_ns(), frame));
        }
        if let Some(hold_ms) = hold_ms {
            held.retain(|(since_ns, _)| monotonic_ns() - since_ns < hold_ms * 1_000_000);
        }
    }
    std::mem::forget((held, relay));
    Ok(Exit::Done)
}
