//! The tracks and forecasts of a run as messages of ROS.
//!
//! [`Output`] fills the messages from the frames of a run and never waits: a thread publishes them. If DDS is
//! slow, the newest messages replace those that wait, which are counted.

use std::collections::{BTreeMap, VecDeque};

use interop::autoware::{self, Tick};
use interop::messages::{DiagnosticArray, MarkerArray, PredictedObjects, TfMessage, TrackedObjects};
use wire::tick_view::TickView;
use wire::{Forecast, Header, LinkCount, StageId, Track, WorldOrigin, flags};

use crate::diagnostics::{self, Link, Pulse, SILENCE_NS};
use crate::options::Options;
use crate::since_stamp::Times;

/// Tracks that wait for the forecasts of their tick.
const WAITING_MAX: usize = 16;

/// A longer time between two ticks is a gap.
const INTERVAL_MAX_NS: u64 = 10_000_000_000;

/// A message to publish.
#[derive(Clone, Debug, PartialEq)]
pub enum Outgoing {
    /// The tracks of a tick, and the ego vehicle's pose.
    Tracks(TrackedObjects, Option<TfMessage>),
    /// The forecasts of a tick, its diagnostics, and its markers if the option is set.
    Forecasts(PredictedObjects, DiagnosticArray, Option<MarkerArray>),
}

/// What became of the ticks so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Published {
    /// Messages with forecasts that DDS has taken.
    pub sent: u64,
    /// Messages that newer ones have replaced, or that DDS had no room for.
    pub dropped: u64,
    /// Objects that were left out because their forecasts were too old.
    pub too_old: u64,
    /// Forecasts whose tracks did not arrive.
    pub unpaired: u64,
    /// Time from the sensor's stamp until DDS has taken the forecasts.
    pub since_stamp: Option<Times>,
}

impl Published {
    /// The counts for the heartbeats of the stage.
    pub fn link(&self) -> impl Iterator<Item = (LinkCount, u64)> {
        let counts = [(LinkCount::Frames, self.sent), (LinkCount::Skipped, self.dropped)];
        let kinds = [LinkCount::SinceStampP50, LinkCount::SinceStampP99, LinkCount::SinceStampMax];
        let times = self.since_stamp.into_iter().flat_map(move |times| kinds.into_iter().zip(times.us()));
        counts.into_iter().chain(times)
    }
}

/// Fills the messages of a run.
#[derive(Debug)]
pub struct Output {
    origin: WorldOrigin,
    budgets_ms: BTreeMap<StageId, f64>,
    frame: String,
    paths: usize,
    max_age_ns: Option<u64>,
    has_tf: bool,
    has_markers: bool,
    waiting: VecDeque<(Header, Vec<Track>)>,
    /// What became of the ticks so far.
    pub published: Published,
    /// The connections of the node.
    pub link: Link,
    pulse: Option<Pulse>,
}

impl Output {
    /// The messages of a run with these options.
    #[must_use]
    pub fn new(run: &run::Run, options: &Options) -> Self {
        let is_vehicle = run.stage(StageId::Source).is_some_and(|source| !source.built_in);
        Self {
            origin: run.origin(),
            budgets_ms: run.budgets_ms(),
            frame: options.frame.clone(),
            paths: options.paths,
            max_age_ns: options.max_age_ms.map(|age_ms| (age_ms * 1e6) as u64),
            has_tf: options.tf.unwrap_or(!is_vehicle),
            has_markers: options.markers,
            waiting: VecDeque::with_capacity(WAITING_MAX),
            published: Published::default(),
            link: Link::default(),
            pulse: None,
        }
    }

    /// The message of a tick's tracks; `None` if the frame is not a tick, or was refused.
    pub fn tracks(&mut self, header: &Header, tracks: &[Track]) -> Option<Outgoing> {
        if !has_agents(header) {
            return None;
        }
        let none = Header { counts: header.counts, ..Header::default() };
        let view = TickView::new((header, tracks), (&none, &[]));
        let tick = Tick { view, tracks, origin: self.origin };
        let mut tracked = autoware::tracked_objects(&tick);
        tracked.header.frame_id.clone_from(&self.frame);
        let mut transforms = autoware::transforms(&tick).filter(|_| self.has_tf);
        for transform in transforms.iter_mut().flat_map(|message| &mut message.transforms) {
            transform.header.frame_id.clone_from(&self.frame);
        }
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back((*header, tracks.to_vec()));
        Some(Outgoing::Tracks(tracked, transforms))
    }

    /// The messages of a tick's forecasts at `now_ns` on `CLOCK_MONOTONIC`; `None` if the frame is not a tick
    /// or its tracks did not arrive.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast], now_ns: u64) -> Option<Outgoing> {
        if !has_agents(header) {
            return None;
        }
        let is_of_tick = |(tracks, _): &(Header, _)| tracks.seq == header.seq;
        let Some(place) = self.waiting.iter().position(is_of_tick) else {
            self.published.unpaired += 1;
            return None;
        };
        let (of, tracks) = self.waiting.drain(..=place).next_back()?;
        let view = TickView::new((&of, &tracks), (header, forecasts));
        let mut tick = Tick { view, tracks: &tracks, origin: self.origin };
        let mut diagnostics = autoware::diagnostics(&tick, header.hops(), &self.budgets_ms);
        let passed_ns = now_ns.saturating_sub(header.released_ns);
        let old = |max_age_ns| autoware::leave_out_old(&mut tick.view, max_age_ns, passed_ns);
        let left_out = self.max_age_ns.map_or(0, old);
        self.published.too_old += left_out;
        // A tick without input has no own time of arrival.
        let input_ns = match self.pulse {
            Some(pulse) if header.has(flags::PREDICTED) => pulse.input_ns,
            _ => header.released_ns,
        };
        let silent_ns = now_ns.saturating_sub(input_ns);
        if header.has(flags::PREDICTED) && silent_ns >= SILENCE_NS {
            diagnostics::mark_silent(&mut diagnostics, silent_ns);
        }
        let stamp_ns = header.stamp_ns;
        // The clock of the stamps may be slower or faster than this machine's.
        let interval_ns =
            self.pulse.map_or(header.interval_ns, |pulse| match now_ns - pulse.published_ns.min(now_ns) {
                apart_ns if apart_ns < INTERVAL_MAX_NS => apart_ns,
                _ => pulse.interval_ns,
            });
        let is_predicted = header.has(flags::PREDICTED);
        self.pulse = Some(Pulse { input_ns, stamp_ns, published_ns: now_ns, interval_ns, is_predicted });
        diagnostics.status.push(diagnostics::of_output(&self.published, left_out, &self.link));
        diagnostics.header.frame_id.clone_from(&self.frame);
        let mut predicted = autoware::predicted_objects(&tick, self.paths);
        predicted.header.frame_id.clone_from(&self.frame);
        let mut markers = self.has_markers.then(|| interop::markers::markers(&tick, self.paths));
        for marker in markers.iter_mut().flat_map(|array| &mut array.markers) {
            marker.header.frame_id.clone_from(&self.frame);
        }
        Some(Outgoing::Forecasts(predicted, diagnostics, markers))
    }

    /// The newest tick that was published.
    #[must_use]
    pub const fn pulse(&self) -> Option<Pulse> {
        self.pulse
    }
}

/// Whether a frame is a tick that no stage has refused. Without this check a reader would take a refused tick
/// for an empty road.
const fn has_agents(header: &Header) -> bool {
    header.is_tick() && !header.has(flags::VOID)
}

#[cfg(test)]
mod tests;
