//! The source of a run whose detections come from ROS.

use std::sync::Arc;
use std::time::{Duration, Instant};

use data::formats::rosbag::{Object, sensor_of};
use interop::messages::{DetectedObjects, DiagnosticArray, TfMessage, TrackedObjects};
use ports::{StageError, monotonic_ns};
use run::{Declaration, Run};
use source::{Inbox, LiveSource};
use wire::{DetectionsTopic, LinkCount, StageId, Topic as _, TruthTopic};

use crate::diagnostics;
use crate::node::{Node, NodeError, Writer, latched, reliable};
use crate::options::{Options, names};
use crate::ticks::{Message, Ticks, World};

/// The stage that this program replaces.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Source, &[], &[DetectionsTopic::NAME, TruthTopic::NAME])
        .with_rule(Options::check);

/// Messages that wait for the stage, transforms included.
const INBOX_MAX: usize = 1024;
/// Longest wait for a message, so that waiting ones go out in time.
const WAIT: Duration = Duration::from_millis(10);
/// A longer time between two messages is a gap.
const INTERVAL_MAX_NS: u64 = 10_000_000_000;
/// Time between two reports of problems.
const REPORT: Duration = Duration::from_secs(5);
/// Queues of subscriptions: as tf2 has them, and as Autoware's subscribers of objects.
const TRANSFORMS_DEPTH: usize = 100;
const DIAGNOSTICS_DEPTH: usize = 10;
/// Time between two diagnostics.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
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
    let mut source = LiveSource::open(run, &STAGE, options.ticks)?;
    // Detections have no identities, and one without makes all untrustworthy.
    source.set_identities(options.detections().is_empty() && !options.tracks.is_empty());
    let inbox = Arc::new(Inbox::new(INBOX_MAX));
    source.set_prediction(options.predict);
    let (node, mut writer) = subscribe(&options, &inbox)?;
    let world = World { frame: options.frame.clone(), origin: run.origin(), pose: options.pose };
    let mut ticks = Ticks::new(world);
    source.link()?;
    // Earlier objects are stale.
    for arrival in inbox.take(Duration::ZERO) {
        if let Arrival::Transforms(message, is_static) = arrival {
            ticks.transform(&message, is_static);
        }
    }
    let mut reported = Instant::now();
    let (mut diagnosed, mut arrived_ns, mut interval_ns) = (Instant::now(), None::<u64>, 0);
    while !source.is_over() {
        source.tend()?;
        for arrival in inbox.take(WAIT) {
            match arrival {
                Arrival::Objects(message) => {
                    let apart_ns = arrived_ns.map(|before_ns| message.arrived_ns.saturating_sub(before_ns));
                    interval_ns = apart_ns.filter(|ns| *ns < INTERVAL_MAX_NS).unwrap_or(interval_ns);
                    arrived_ns = Some(message.arrived_ns);
                    ticks.message(message);
                }
                Arrival::Transforms(message, is_static) => ticks.transform(&message, is_static),
            }
        }
        while !source.is_over()
            && let Some(tick) = ticks.next(monotonic_ns())
        {
            source.send(&tick)?;
        }
        if diagnosed.elapsed() >= DIAGNOSTICS {
            diagnosed = Instant::now();
            let age_ns = arrived_ns.map(|arrived_ns| monotonic_ns().saturating_sub(arrived_ns));
            let (counts, link) = (ticks.counts(), node.connections().link());
            let header = diagnostics::header_now(node.simulated_ns(), &options.frame);
            let unread = inbox.dropped();
            let skipped = counts.dropped + unread;
            source.set_link([(LinkCount::Frames, counts.messages), (LinkCount::Skipped, skipped)]);
            writer.publish(diagnostics::of_input(&counts, unread, age_ns, interval_ns, &link, header));
        }
        if reported.elapsed() >= REPORT
            && let Some(problem) = ticks.take_problem()
        {
            reported = Instant::now();
            let (counts, dropped) = (ticks.counts(), inbox.dropped());
            tracing::warn!("{problem}; so far {counts}; {dropped} dropped before they were read");
        }
    }
    drop(node);
    inbox.close();
    tracing::info!("{}", ticks.counts());
    source.end();
    Ok(())
}

/// Opens the subscriptions, whose threads fill the inbox.
fn subscribe(
    options: &Options,
    inbox: &Arc<Inbox<Arrival>>,
) -> Result<(Node, Writer<DiagnosticArray>), NodeError> {
    let mut node = Node::open(options, "source")?;
    let qos = reliable(OBJECTS_DEPTH);
    let qos = if options.best_effort { qos.reliability_best_effort() } else { qos };
    let detections = options.detections();
    let has_several = detections.len() + options.tracks.len() > 1;
    let sensor = |place: usize| sensor_of(has_several.then_some(place));
    for (place, name) in detections.iter().enumerate() {
        let (inbox, sensor) = (Arc::clone(inbox), sensor(place));
        let take = move |DetectedObjects { header, objects }: DetectedObjects| {
            let objects = objects.into_iter().map(Object::from).collect();
            inbox.push(Arrival::Objects(Message { header, objects, sensor, arrived_ns: monotonic_ns() }))
        };
        node.read(options.topic(name), &DetectedObjects::DEFINITION, &qos, take)?;
    }
    for (place, name) in options.tracks.iter().enumerate() {
        let (inbox, sensor) = (Arc::clone(inbox), sensor(detections.len() + place));
        let take = move |TrackedObjects { header, objects }: TrackedObjects| {
            let objects = objects.into_iter().map(Object::from).collect();
            inbox.push(Arrival::Objects(Message { header, objects, sensor, arrived_ns: monotonic_ns() }))
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
    read.iter().for_each(|topic| node.need(topic));
    tracing::info!("reads {}", read.join(", "));
    let diagnostics = options.topic(names::DIAGNOSTICS);
    let writer = node.writer(diagnostics, &DiagnosticArray::DEFINITION, &reliable(DIAGNOSTICS_DEPTH))?;
    Ok((node, writer))
}
