//! Windows of a recording: the known states at a time (history), and the positions after it (future).

use std::collections::BTreeMap;

use scene::State;
use wire::{OFFSET_MAX_NS, detection_flags};

use crate::{Frame, RecordedTrack, Recording, Reported, tracks, tracks_from_positions};

/// Options for cutting a recording into windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowOptions {
    /// Steps of the history, T_h, including the window's own time.
    pub history_len: usize,
    /// Steps of the future, T_f.
    pub horizon_len: usize,
    /// Time between steps, Δt.
    pub step_ns: i64,
    /// Time from one window to the next. If it is not a multiple of the recording's interval, the nearest
    /// frame is used.
    pub stride_ns: i64,
    /// Longest gap between recorded states that is interpolated. Gaps of up to one and a half of the
    /// recording's intervals are always interpolated. A recording that is slower than the steps therefore has
    /// states at the steps too.
    pub gap_max_ns: i64,
    /// Minimum number of history steps at which an agent of the window is present. The newest step is always
    /// one of them.
    pub history_present_min: usize,
    /// Whether velocities and headings come from the positions even if the recording has its own.
    pub from_positions: bool,
}

impl WindowOptions {
    /// Windows one step apart, of all agents that are present at the window's time.
    #[must_use]
    pub const fn new(history_len: usize, horizon_len: usize, step_ns: i64) -> Self {
        Self {
            history_len,
            horizon_len,
            step_ns,
            stride_ns: step_ns,
            gap_max_ns: step_ns,
            history_present_min: 1,
            from_positions: false,
        }
    }
}

/// An agent in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowAgent {
    /// Identity in the recording.
    pub id: u64,
    /// The agent's attributes as known at the window's time.
    pub reported: Reported,
    /// States at `stamp_ns − (T_h − 1 − k) Δt`, oldest first; `None` if absent.
    pub history: Vec<Option<State>>,
    /// Positions at `stamp_ns + (k + 1) Δt`; `None` if absent.
    pub future: Vec<Option<[f32; 2]>>,
}

impl WindowAgent {
    /// Whether the agent is present at every step of history and future.
    pub fn is_complete(&self) -> bool {
        self.history.iter().all(Option::is_some) && self.future.iter().all(Option::is_some)
    }

    /// History steps at which the agent is present.
    fn history_present_count(&self) -> usize {
        self.history.iter().flatten().count()
    }
}

/// One time of a recording, with the agents that are present.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// The stamp of a frame: the newest time of the histories.
    pub stamp_ns: i64,
    /// The agents, by identity.
    pub agents: Vec<WindowAgent>,
}

/// Cuts a recording into windows, in time order.
///
/// A window is at the stamp of a frame that observed every agent type that the recording ever observed.
/// Histories are interpolated only between states recorded at or before the window's time, and futures also
/// between later ones. Steps at recorded times are the recorded states themselves. So a recording of any rate
/// has windows. If its interval divides the step and no frame is missing, nothing is interpolated.
///
/// An agent that was measured at another time than its frame's stamp is moved to the stamp by its last
/// velocity. Windows without agents are left out.
///
/// # Panics
/// If a length or the step of `options` is 0 or negative.
#[must_use]
pub fn windows(recording: &Recording, options: &WindowOptions) -> Vec<Window> {
    assert!(options.history_len > 0 && options.step_ns > 0 && options.stride_ns > 0, "empty window");
    let tracks = if options.from_positions { tracks_from_positions(recording) } else { tracks(recording) };
    let ever_observed = recording.frames.iter().fold(0, |bits, frame| bits | frame.observed_types);
    let whole = recording.frames.iter().filter(|frame| frame.observed_types == ever_observed);

    let interval_ns = i64::try_from(recording.interval_ns).unwrap_or(i64::MAX);
    let options = &WindowOptions {
        gap_max_ns: options.gap_max_ns.max(interval_ns.saturating_add(interval_ns / 2)),
        ..*options
    };
    // A frame that is half an interval early still counts as the due frame.
    let apart_ns = options.stride_ns.saturating_sub(interval_ns / 2).max(1);

    let mut alive = Alive::new(&tracks);
    let mut windows: Vec<Window> = Vec::new();
    let mut earliest_ns = i64::MIN;
    for frame in whole {
        if frame.stamp_ns < earliest_ns {
            continue;
        }
        earliest_ns = frame.stamp_ns.saturating_add(apart_ns);
        let offsets_ns = offsets_ns(frame);
        let offset_ns = |track: &RecordedTrack| offsets_ns.get(&track.id).copied().unwrap_or(0);
        let begun = alive.at(frame.stamp_ns);
        let agents: Vec<WindowAgent> =
            begun.filter_map(|track| agent(track, frame.stamp_ns, offset_ns(track), options)).collect();
        if !agents.is_empty() {
            windows.push(Window { stamp_ns: frame.stamp_ns, agents });
        }
    }
    windows
}

/// The offsets of agents that were measured at another time than the frame's stamp.
fn offsets_ns(frame: &Frame) -> BTreeMap<u64, i64> {
    let shifted = frame.detections.iter().filter(|d| d.offset_ns != 0 && d.has(detection_flags::HAS_ID));
    shifted.map(|detection| (detection.id, detection.offset_ns)).collect()
}

fn agent(
    track: &RecordedTrack,
    stamp_ns: i64,
    offset_ns: i64,
    options: &WindowOptions,
) -> Option<WindowAgent> {
    let steps = options.history_len as i64;
    let state_at = |step: i64, now_ns: i64| {
        let at_ns = stamp_ns.checked_add(step.checked_mul(options.step_ns)?)?;
        track.state_at(at_ns, now_ns, options.gap_max_ns)
    };
    let now = match offset_ns {
        0 => state_at(0, stamp_ns)?,
        _ => track.state_now(stamp_ns, offset_ns)?,
    };
    let history = (1 - steps..0).map(|step| state_at(step, stamp_ns)).chain([Some(now)]);
    let agent = WindowAgent {
        id: track.id,
        reported: track.reported_at(stamp_ns),
        history: history.collect(),
        future: (1..=options.horizon_len as i64)
            .map(|step| state_at(step, i64::MAX).map(|state| state.position_m))
            .collect(),
    };
    (agent.history_present_count() >= options.history_present_min).then_some(agent)
}

/// Finds the tracks that span a time, for increasing times. Tracks that ended at most the largest offset
/// before it count too.
struct Alive<'a> {
    /// The tracks that have not started, the next one last.
    waiting: Vec<&'a RecordedTrack>,
    /// The tracks that have started and not ended, by identity.
    begun: Vec<&'a RecordedTrack>,
}

impl<'a> Alive<'a> {
    fn new(tracks: &'a [RecordedTrack]) -> Self {
        let mut waiting: Vec<&RecordedTrack> = tracks.iter().collect();
        waiting.sort_by_key(|track| std::cmp::Reverse(track.states.first().map(|state| state.0)));
        Self { waiting, begun: Vec::new() }
    }

    fn at(&mut self, stamp_ns: i64) -> impl Iterator<Item = &'a RecordedTrack> {
        while let Some(track) =
            self.waiting.pop_if(|track| track.states.first().is_some_and(|s| s.0 <= stamp_ns))
        {
            self.begun.push(track);
        }
        let ended_ns = stamp_ns.saturating_sub(OFFSET_MAX_NS as i64);
        self.begun.retain(|track| track.states.last().is_some_and(|state| state.0 >= ended_ns));
        self.begun.sort_by_key(|track| track.id);
        self.begun.iter().copied()
    }
}
