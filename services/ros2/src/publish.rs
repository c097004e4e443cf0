//! Publishes the messages of a run: as a stage of pipeline.toml, or as a tool that follows a run through its
//! tap.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use interop::messages::{DiagnosticArray, MarkerArray, PredictedObjects, TfMessage, TrackedObjects};
use ports::{Awaited, Stage, StageError, Stop, monotonic_ns};
use recording::About;
use recording::tap::{Client, Item, Request};
use run::{Declaration, Run};
use wire::{Forecast, ForecastsTopic, Header, Topic as _, Track, TracksTopic, flags};

use crate::diagnostics::{self, Pulse};
use crate::node::{Connections, FAREWELL, Node, NodeError, Writer, reliable};
use crate::options::{Options, names};
use crate::output::{Outgoing, Output, Published};
use crate::since_stamp::SinceStamp;
use crate::ticks::time_ns;

/// The stage, which pipeline.toml adds. No tick waits for it.
pub const STAGE: Declaration<Options> =
    Declaration::added(&[TracksTopic::NAME, ForecastsTopic::NAME], &[]).with_rule(Options::check);

/// Time after a tick's release for which its forecasts are awaited.
const FORECASTS_LIMIT_NS: u64 = 1_000_000_000;
/// Longest wait for a frame of the tap.
const WAIT: Duration = Duration::from_millis(100);
/// Time between two diagnostics without a tick, and between two looks at the connections.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// Bounds of the time between two frames without a tick.
const EMPTY_MIN_NS: u64 = 80_000_000;
const EMPTY_MAX_NS: u64 = 1_000_000_000;
/// Time between two reports of losses.
const REPORT: Duration = Duration::from_secs(10);
/// Queues of the publishers, as Autoware and tf2 have them.
const OBJECTS_DEPTH: usize = 1;
const DIAGNOSTICS_DEPTH: usize = 10;
const TRANSFORMS_DEPTH: usize = 100;

/// Publishes the run that this process is a stage of.
///
/// # Errors
/// [`StageError`] if an option, DDS or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let mut stage = Stage::open(run, &STAGE)?;
    let tracks = stage.subscribe_deep::<TracksTopic>(TracksTopic::DEPTH_MAX)?;
    let forecasts = stage.subscribe_deep::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let mut bridge = Bridge::open(run, &options)?;
    while let Some(frame) = stage.take(&tracks)? {
        let header = *frame.header();
        bridge.tracks(&header, &frame);
        drop(frame);
        if header.has(flags::END) {
            break;
        }
        if !header.is_tick() || header.has(flags::VOID) {
            continue;
        }
        let until_ns = (!run.lockstep).then(|| header.released_ns.saturating_add(FORECASTS_LIMIT_NS));
        match stage.wait_for(&forecasts, header.seq, until_ns)? {
            Awaited::Frame(frame) => bridge.forecasts(frame.header(), &frame),
            Awaited::Stopped => break,
            Awaited::Void(_) | Awaited::Late | Awaited::Lost(_) => {}
        }
        stage.done(header.seq);
        stage.set_link(bridge.output.published.link());
    }
    bridge.close();
    Ok(())
}

/// Why a run can't be followed.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// The run's files can't be read.
    #[error("{0}")]
    Run(String),
    /// DDS can't be used.
    #[error(transparent)]
    Node(#[from] NodeError),
}

/// Publishes a run, by its folder, until it ends or `stop` is requested.
///
/// # Errors
/// [`FollowError`] if the run or DDS can't be used.
pub fn follow(root: &Path, options: &Options, stop: &Stop) -> Result<(), FollowError> {
    let failed = |error: &dyn std::fmt::Display| FollowError::Run(error.to_string());
    let about = About::of_run(root).map_err(|error| failed(&error))?;
    let topics = vec![TracksTopic::NAME.to_owned(), ForecastsTopic::NAME.to_owned()];
    let request = Request { tool: "ros2".to_owned(), topics, events: false, mark: None, recording: None };
    let mut tap = Client::attach(root, &request).map_err(|error| failed(&error))?;
    let mut bridge = Bridge::open(&about.run, options)?;
    while !stop.requested() && !tap.is_closed() {
        match tap.next(WAIT).map_err(|error| failed(&error))? {
            Some(Item::Frame(frame)) if frame.topic().name == TracksTopic::NAME => {
                if let Ok(tracks) = frame.elements::<TracksTopic>() {
                    bridge.tracks(frame.header(), &tracks);
                }
            }
            Some(Item::Frame(frame)) => {
                if let Ok(forecasts) = frame.elements::<ForecastsTopic>() {
                    bridge.forecasts(frame.header(), &forecasts);
                }
            }
            Some(Item::Lost(lost)) => {
                tracing::warn!("{} frames of {} were lost at the tap", lost.frames, lost.topic());
            }
            Some(Item::Refused(why)) => return Err(FollowError::Run(why)),
            Some(_) | None => {}
        }
    }
    bridge.close();
    Ok(())
}

/// Fills messages, and passes them to the thread that publishes them.
struct Bridge {
    output: Output,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    connections: Connections,
    looked: Instant,
    reported: Instant,
    /// The count of lost messages that was logged.
    logged: u64,
}

impl Bridge {
    fn open(run: &Run, options: &Options) -> Result<Self, NodeError> {
        let shared = Arc::new(Shared::default());
        let writers = Writers::open(options)?;
        let connections = writers.node.connections();
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("ros2-writer".to_owned());
        let thread = thread.spawn(move || writers.publish(&of_thread))?;
        let output = Output::new(run, options);
        let now = Instant::now();
        let (thread, looked, reported) = (Some(thread), now, now);
        Ok(Self { output, shared, thread, connections, looked, reported, logged: 0 })
    }

    fn tracks(&mut self, header: &Header, tracks: &[Track]) {
        if let Some(outgoing) = self.output.tracks(header, tracks) {
            self.shared.put(outgoing);
        }
    }

    fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) {
        self.output.published.sent = self.shared.sent.load(Ordering::Relaxed);
        self.output.published.dropped = self.shared.dropped.load(Ordering::Relaxed);
        if self.looked.elapsed() >= DIAGNOSTICS {
            self.looked = Instant::now();
            self.output.published.since_stamp = self.shared.since_stamp().times();
            self.output.link = self.connections.link();
        }
        if let Some(outgoing) = self.output.forecasts(header, forecasts, monotonic_ns()) {
            self.shared.slots().newest = self.output.pulse().map(|pulse| (pulse, self.output.published));
            self.shared.put(outgoing);
        }
        if self.reported.elapsed() >= REPORT {
            self.report();
        }
    }

    /// Logs the losses if there are new ones.
    fn report(&mut self) {
        self.reported = Instant::now();
        let published = self.output.published;
        let lost = published.dropped + published.unpaired;
        if lost > self.logged {
            self.logged = lost;
            tracing::warn!(
                "{} of {} messages were dropped, and {} ticks came without tracks",
                published.dropped,
                published.sent + published.dropped,
                published.unpaired
            );
        }
    }

    /// Ends the thread. DDS gets time to inform the readers.
    fn close(mut self) {
        self.shared.close();
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the thread that publishes has panicked");
        }
        self.output.published.dropped = self.shared.dropped.load(Ordering::Relaxed);
        self.output.published.sent = self.shared.sent.load(Ordering::Relaxed);
        self.report();
        std::thread::sleep(FAREWELL);
    }
}

/// The newest messages on their way to the thread.
#[derive(Debug, Default)]
struct Shared {
    slots: Mutex<Slots>,
    changed: Condvar,
    sent: AtomicU64,
    dropped: AtomicU64,
    since_stamp: Mutex<SinceStamp>,
}

#[derive(Debug, Default)]
struct Slots {
    tracks: Option<(TrackedObjects, Option<TfMessage>)>,
    forecasts: Option<(PredictedObjects, DiagnosticArray, Option<MarkerArray>)>,
    /// The newest tick, and what had become of the ticks.
    newest: Option<(Pulse, Published)>,
    is_closed: bool,
}

impl Shared {
    fn slots(&self) -> MutexGuard<'_, Slots> {
        // Every change of the slots is a single assignment, so a panic leaves them whole.
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn since_stamp(&self) -> MutexGuard<'_, SinceStamp> {
        self.since_stamp.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the message of the same kind that still waits.
    fn put(&self, outgoing: Outgoing) {
        let mut slots = self.slots();
        let is_replaced = match outgoing {
            Outgoing::Tracks(tracked, tf) => slots.tracks.replace((tracked, tf)).is_some(),
            Outgoing::Forecasts(predicted, diagnostics, markers) => {
                slots.forecasts.replace((predicted, diagnostics, markers)).is_some()
            }
        };
        drop(slots);
        self.dropped.fetch_add(u64::from(is_replaced), Ordering::Relaxed);
        self.changed.notify_one();
    }

    fn close(&self) {
        self.slots().is_closed = true;
        self.changed.notify_one();
    }

    /// The messages that wait. Waits for the first, at most for `limit`.
    fn take(&self, limit: Duration) -> Slots {
        let is_idle =
            |slots: &mut Slots| slots.tracks.is_none() && slots.forecasts.is_none() && !slots.is_closed;
        let waited = self.changed.wait_timeout_while(self.slots(), limit, is_idle);
        let mut slots = waited.unwrap_or_else(PoisonError::into_inner).0;
        let (tracks, forecasts) = (slots.tracks.take(), slots.forecasts.take());
        Slots { tracks, forecasts, newest: slots.newest, is_closed: slots.is_closed }
    }
}

/// The publishers.
struct Writers {
    tracked: Writer<TrackedObjects>,
    predicted: Writer<PredictedObjects>,
    tf: Writer<TfMessage>,
    diagnostics: Writer<DiagnosticArray>,
    markers: Option<Writer<MarkerArray>>,
    frame: String,
    node: Node,
}

impl Writers {
    fn open(options: &Options) -> Result<Self, NodeError> {
        let mut node = Node::open(options, "prediction")?;
        let objects = reliable(OBJECTS_DEPTH);
        Ok(Self {
            tracked: node.writer(options.topic(names::TRACKED), &TrackedObjects::DEFINITION, &objects)?,
            predicted: node.writer(
                options.topic(names::PREDICTED),
                &PredictedObjects::DEFINITION,
                &objects,
            )?,
            tf: node.writer(options.topic(names::TF), &TfMessage::DEFINITION, &reliable(TRANSFORMS_DEPTH))?,
            diagnostics: node.writer(
                options.topic(names::DIAGNOSTICS),
                &DiagnosticArray::DEFINITION,
                &reliable(DIAGNOSTICS_DEPTH),
            )?,
            markers: options
                .markers
                .then(|| node.writer(options.topic(names::MARKERS), &MarkerArray::DEFINITION, &objects))
                .transpose()?,
            frame: options.frame.clone(),
            node,
        })
    }

    fn publish(mut self, shared: &Shared) {
        let opened_ns = monotonic_ns();
        let (mut interval_ns, mut emptied_ns, mut diagnosed) = (EMPTY_MAX_NS, 0, Instant::now());
        loop {
            let Slots { tracks, forecasts, newest, is_closed } =
                shared.take(Duration::from_nanos(interval_ns));
            if is_closed && tracks.is_none() && forecasts.is_none() {
                return;
            }
            let before = self.counts();
            if let Some((tracked, tf)) = tracks {
                tf.into_iter().for_each(|tf| {
                    self.tf.publish(tf);
                });
                self.tracked.publish(tracked);
            }
            if let Some((predicted, diagnostics, markers)) = forecasts {
                let stamp_ns = time_ns(&predicted.header.stamp);
                let is_taken = self.predicted.publish(predicted);
                // The newest tick may already be the next one.
                let is_measured = |(pulse, _): &(Pulse, _)| pulse.stamp_ns == stamp_ns && !pulse.is_predicted;
                if is_taken && newest.as_ref().is_some_and(is_measured) {
                    let now_ns = self.node.simulated_ns().unwrap_or_else(diagnostics::realtime_ns);
                    shared.since_stamp().record(stamp_ns, now_ns);
                }
                self.diagnostics.publish(diagnostics);
                diagnosed = Instant::now();
                markers.into_iter().zip(&mut self.markers).for_each(|(markers, writer)| {
                    writer.publish(markers);
                });
            }
            let now_ns = monotonic_ns();
            let pulse = newest.map(|(pulse, _)| pulse);
            interval_ns = pulse.map_or(EMPTY_MAX_NS, |p| p.interval_ns.clamp(EMPTY_MIN_NS, EMPTY_MAX_NS));
            let since_ns = pulse.map_or(opened_ns, |pulse| pulse.published_ns);
            if now_ns.saturating_sub(since_ns) >= pulse.unwrap_or_default().silence_ns()
                && now_ns.saturating_sub(emptied_ns) >= interval_ns
                && !is_closed
            {
                emptied_ns = now_ns;
                self.silence(newest, now_ns, &mut diagnosed);
            }
            let now = self.counts();
            shared.sent.fetch_add(now[0] - before[0], Ordering::Relaxed);
            shared.dropped.fetch_add(now[1] - before[1], Ordering::Relaxed);
        }
    }

    /// Publishes that there is no tick.
    fn silence(&mut self, newest: Option<(Pulse, Published)>, now_ns: u64, diagnosed: &mut Instant) {
        let published = newest.map_or_else(Published::default, |(_, published)| published);
        let of_bridge = diagnostics::of_output(&published, 0, &self.node.connections().link());
        let pulse = newest.map(|(pulse, _)| pulse);
        let simulated_ns = self.node.simulated_ns();
        let (predicted, diagnostics) =
            diagnostics::silent(pulse.as_ref(), simulated_ns, &self.frame, now_ns, of_bridge);
        if let Some(predicted) = predicted {
            self.predicted.publish(predicted);
        }
        if diagnosed.elapsed() >= DIAGNOSTICS {
            *diagnosed = Instant::now();
            self.diagnostics.publish(diagnostics);
        }
    }

    fn counts(&self) -> [u64; 2] {
        let [tracked, predicted] = [self.tracked.counts(), self.predicted.counts()];
        [tracked[0] + predicted[0], tracked[1] + predicted[1]]
    }
}
