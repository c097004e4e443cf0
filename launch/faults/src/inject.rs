//! The injector: a process between a topic's writer and its readers. The module also has an additional
//! consumer of a topic.

use std::path::Path;
use std::time::Duration;

use console::failure::Failure;
use ports::{PortError, RawTopic, Relay, monotonic_ns};
use run::{Exit, Run, injected_name};
use wire::Protection;

use crate::checker::Line;
use crate::effect::TopicFault;
use crate::effect::{Due, Injector, Raw};
use crate::follow::print;

/// Longest sleep between checks that the run is still there.
const SLEEP: Duration = Duration::from_millis(50);
/// Maximum number of frames that a consumer holds: the transport's limit per reader.
const HELD_MAX: usize = 3;

/// Injects the faults of a plan for one topic until the process is asked to end or the run's folder is gone.
pub fn inject(record: &Path, plan: &Path) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    let text = std::fs::read(plan).map_err(|error| Failure::file(plan, error))?;
    let faults: Vec<TopicFault> =
        serde_json::from_slice(&text).map_err(|error| Failure::file(plan, error))?;
    let topic = faults.first().map(|fault| fault.topic.clone()).unwrap_or_default();
    let topic = topic_of(&run, &topic)?;
    let injector = Injector::new(faults, topic.element_size, topic.element);
    let passage = Relay::open(&run, topic.clone(), &injected_name(&topic.name))?;
    relay(passage, &run, &topic, injector)
}

/// Reads a topic as an additional consumer. It holds its frames for `hold_ms`, or forever.
pub fn consume(record: &Path, topic: &str, hold_ms: Option<u64>) -> Result<Exit, Failure> {
    let run = Run::read(record).map_err(Failure::config)?;
    hold(Relay::consumer(&run, topic_of(&run, topic)?)?, &run, hold_ms)
}

/// The topic of this name, which is built in or declared in the pipeline file.
fn topic_of(run: &Run, name: &str) -> Result<RawTopic, Failure> {
    let topic = RawTopic::of(run, name).filter(|topic| topic.publishers_max() == 1);
    topic.ok_or_else(|| Failure::Usage(format!("there is no topic \"{name}\" with one writer")))
}

/// Sends a frame. Wrong content of the sender gets a matching check value.
fn send(passage: &Relay, topic: &RawTopic, Raw { header, payload, is_lie }: &Raw) -> Result<(), PortError> {
    let (mut header, whole_len) = (*header, payload.len() / topic.element_size * topic.element_size);
    if *is_lie && !header.protection.is_absent() {
        let (payload, counter) = (&payload[..whole_len], header.protection.counter);
        header.protection = Protection::of_bytes(&topic.name, &header, payload, counter);
    }
    passage.send(&header, payload)
}

fn relay(passage: Relay, run: &Run, topic: &RawTopic, mut injector: Injector) -> Result<Exit, Failure> {
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
            let raw = Raw { header: *frame.header(), payload: frame.payload().to_vec(), is_lie: false };
            drop(frame);
            let (tick, is_tick) = (raw.header.seq, raw.header.is_tick());
            let (due, kinds) = injector.pass(raw);
            for Due { frame, delay_ns } in due {
                if delay_ns == 0 {
                    send(&passage, topic, &frame)?;
                } else {
                    waiting.push((begun_ns + delay_ns, frame));
                }
            }
            if is_tick {
                costs_ns.push(monotonic_ns() - begun_ns);
            }
            if !kinds.is_empty() {
                let kinds = kinds.into_iter().map(str::to_owned).collect();
                print(&Line::Injected { topic: topic.name.clone(), tick, kinds })?;
            }
        }
        waiting.sort_by_key(|(due_ns, _)| *due_ns);
        let now_ns = monotonic_ns();
        let due_len = waiting.partition_point(|(due_ns, _)| *due_ns <= now_ns);
        for (_, frame) in waiting.drain(..due_len) {
            send(&passage, topic, &frame)?;
        }
        let next = waiting.first().map(|(due_ns, _)| Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        passage.sleep(next.map_or(SLEEP, |next| next.min(SLEEP)))?;
    }
    costs_ns.sort_unstable();
    print(&Line::Cost {
        topic: topic.name.clone(),
        frames: costs_ns.len() as u64,
        us_p50: costs_ns.get(costs_ns.len() / 2).map_or(0, |ns| ns / 1_000),
        us_max: costs_ns.last().map_or(0, |ns| ns / 1_000),
    })?;
    // The launcher removes the run's files. Ports dropped after that would look for them.
    std::mem::forget(passage);
    Ok(Exit::Done)
}

fn hold(passage: Relay, run: &Run, hold_ms: Option<u64>) -> Result<Exit, Failure> {
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
