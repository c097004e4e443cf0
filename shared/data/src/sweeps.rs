//! From rows to frames: the only module that turns measurements into sweeps.
//!
//! Formats that number their frames have exact stamps: the rows of one stamp are a frame ([`numbered`]). Rows
//! with their own stamps ([`measured`]) are joined to sweeps. Detections of one sweep can have different
//! stamps because of several sensors, a stamp for each object, or microseconds of jitter.
//!
//! A sweep contains an identity at most once and spans at most L = T − G / 2. T is the interval between the
//! rows of an agent ([`interval`]). G is the usual gap between different stamps: half of the time passes in
//! gaps of G or longer. Stamps that are T apart therefore never join, even with jitter up to half of T. A
//! sweep whose objects are spread over all of T stays whole.
//!
//! Dynamic programming finds the best way to cut the rows into such sweeps: the one with the smallest sum of
//! T + span over the sweeps. It cuts at the longest gaps, and stays in phase if a sensor drops a frame.
//!
//! The frame's stamp is the time of its newest measurement, so an update at a detection's own time never
//! looks ahead. [`Detection::offset_ns`] is 0 or negative.

use std::collections::HashMap;

use wire::{AGENT_TYPES, Detection, OFFSET_MAX_NS, Truth, detection_flags};

use crate::egos::Egos;
use crate::interval;
use crate::lines::{Lines, Paths};
use crate::row::Row;
use crate::rows::{self, ALL_TYPES, Rows};
use crate::{Ego, Frame, FrameRate, Input, ReadError, Recording};

/// Fewest frames with a type that show the type's own rate.
const RATE_FRAMES_MIN: usize = 8;

/// Frames from rows with their own stamps.
#[derive(Debug)]
pub(crate) struct Sweeps {
    pub frames: Vec<Frame>,
    /// The usual time between the rows of an agent, or else between frames; `None` for a single frame.
    pub interval_ns: Option<u64>,
    /// Frames without a pose of a moving sensor near enough in time.
    pub poses_missing: usize,
}

/// Frames from rows that are sorted by time, one for each stamp. A fixed sensor observes `observed_types` all
/// the time. The sensor's position is the mean position of the first frame's detections, because the mean of
/// all frames would leak the future. Rows with identities are their own truth.
pub(crate) fn numbered(rows: &[Row<'_>], observed_types: u32) -> Vec<Frame> {
    frames(rows.chunk_by(|a, b| a.stamp_ns == b.stamp_ns), observed_types)
}

/// The recording of a file whose rows have identities and frame numbers at this rate. A step is
/// `frames_per_step` frames.
pub(crate) fn identified(
    rows: Rows<'_>,
    input: &Input,
    observed_types: u32,
    rate: FrameRate,
    frames_per_step: u32,
) -> Result<Recording, ReadError> {
    Ok(Recording {
        interval_ns: rate.interval_ns(frames_per_step),
        has_identities: true,
        frames: numbered(&rows.sorted(input)?, observed_types),
        frame_rate: Some(rate),
        ..Recording::default()
    })
}

/// Frames from rows that are sorted by time, one for each sweep, with the sensor's poses. All types are
/// observed all the time, unless a type comes at a lower rate. Before the first pose, the sensor's position
/// is the mean position of the first frame's detections. Rows with identities are their own truth.
pub(crate) fn measured(rows: &[Row<'_>], egos: &Egos) -> Sweeps {
    let interval_ns = interval::of_sweeps_ns(rows);
    let ends = sweep_ends(rows, interval_ns);
    let starts = std::iter::once(0).chain(ends.iter().copied());
    let mut frames = frames(starts.zip(&ends).map(|(start, &end)| &rows[start..end]), ALL_TYPES);
    let before = frames.first().map_or_else(Ego::default, |frame| frame.ego);
    let (poses, poses_missing) = egos.at(frames.iter().map(|frame| frame.stamp_ns), before);
    frames.iter_mut().zip(poses).for_each(|(frame, ego)| frame.ego = ego);
    let stamps_ns: Vec<i64> = frames.iter().map(|frame| frame.stamp_ns).collect();
    let interval_ns = interval_ns.or_else(|| interval::usual_ns(&stamps_ns)).map(i64::unsigned_abs);
    observe(&mut frames, interval_ns.unwrap_or(0));
    Sweeps { frames, interval_ns, poses_missing }
}

fn frames<'r, 'a: 'r>(sweeps: impl Iterator<Item = &'r [Row<'a>]>, observed_types: u32) -> Vec<Frame> {
    let mut sweeps = sweeps.filter(|sweep| !sweep.is_empty()).peekable();
    let position_m = sweeps.peek().map_or([0.0; 2], |first| centre_m(first));
    let ego = Ego { position_m, ..Ego::default() };
    let mut paths = Paths::default();
    sweeps
        .map(|sweep| {
            let stamp_ns = sweep.iter().map(|row| row.stamp_ns).max().unwrap_or(0);
            let own = |row: &Row<'_>| Detection { offset_ns: row.stamp_ns - stamp_ns, ..row.detection };
            let mut detections: Vec<Detection> = sweep.iter().map(own).collect();
            let mut lines = Lines::default();
            sweep.iter().for_each(|row| lines.push(paths.line(row)));
            rows::sort(&mut detections, &mut lines);
            let identified = detections.iter().filter(|d| d.has(detection_flags::HAS_ID));
            let truth: Vec<Truth> = identified.map(rows::truth_of).collect();
            Frame { stamp_ns, observed_types, ego, detections, truth, lines }
        })
        .collect()
}

/// The mean of all positions.
fn centre_m(rows: &[Row<'_>]) -> [f32; 2] {
    let mean = |of: fn(&Detection) -> f32| {
        let sum: f64 = rows.iter().map(|row| f64::from(of(&row.detection))).sum();
        (sum / rows.len().max(1) as f64) as f32
    };
    [mean(|d| d.x_m), mean(|d| d.y_m)]
}

/// Rows of one stamp.
#[derive(Clone, Copy)]
struct Instant {
    stamp_ns: i64,
    /// The index after its last row.
    end: usize,
}

/// The best way to cut the rows up to a given stamp.
#[derive(Clone, Copy)]
struct Cut {
    cost_ns: i128,
    /// The first instant of the last sweep.
    first: usize,
}

/// The indices after the last row of each sweep. If the interval is unknown, each stamp is a sweep.
fn sweep_ends(rows: &[Row<'_>], interval_ns: Option<i64>) -> Vec<usize> {
    let mut end = 0;
    let instants: Vec<Instant> = rows
        .chunk_by(|a, b| a.stamp_ns == b.stamp_ns)
        .map(|chunk| {
            end += chunk.len();
            Instant { stamp_ns: chunk[0].stamp_ns, end }
        })
        .collect();
    let Some(interval_ns) = interval_ns else {
        return instants.iter().map(|instant| instant.end).collect();
    };
    let span_max_ns = (interval_ns - usual_gap_ns(&instants, interval_ns) / 2).min(OFFSET_MAX_NS as i64);

    let mut cuts: Vec<Cut> = Vec::with_capacity(instants.len());
    let mut newest: HashMap<u64, usize> = HashMap::new();
    let mut least = 0;
    let mut start = 0;
    for (place, instant) in instants.iter().enumerate() {
        for row in &rows[start..instant.end] {
            if row.detection.has(detection_flags::HAS_ID)
                && let Some(before) = newest.insert(row.detection.id, place)
            {
                least = least.max(before + 1);
            }
        }
        start = instant.end;
        while instant.stamp_ns - instants[least].stamp_ns > span_max_ns {
            least += 1;
        }
        let cost_ns = |first: usize| {
            let before_ns = first.checked_sub(1).map_or(0, |last| cuts[last].cost_ns);
            before_ns + i128::from(interval_ns) + i128::from(instant.stamp_ns - instants[first].stamp_ns)
        };
        let best = (least..=place).map(|first| Cut { cost_ns: cost_ns(first), first });
        cuts.extend(best.min_by_key(|cut| cut.cost_ns));
    }

    let mut ends = Vec::new();
    let mut next = instants.len();
    while let Some(last) = next.checked_sub(1) {
        ends.push(instants[last].end);
        next = cuts[last].first;
    }
    ends.reverse();
    ends
}

/// The usual gap between different stamps within the interval: half of the time passes in gaps of this length
/// or longer. Pauses do not count.
fn usual_gap_ns(instants: &[Instant], interval_ns: i64) -> i64 {
    let gaps = instants.windows(2).map(|pair| pair[1].stamp_ns - pair[0].stamp_ns);
    let mut gaps: Vec<i64> =
        gaps.filter(|gap_ns| *gap_ns <= interval_ns * 3 / 2).map(|gap_ns| gap_ns.min(interval_ns)).collect();
    gaps.sort_unstable();
    let total_ns: i128 = gaps.iter().copied().map(i128::from).sum();
    let mut passed_ns = 0;
    let half = gaps.into_iter().find(|gap_ns| {
        passed_ns += i128::from(*gap_ns);
        2 * passed_ns >= total_ns
    });
    half.unwrap_or(interval_ns)
}

/// Marks the frames that did not observe a type whose detections have a lower rate than the frames. A frame
/// observes a type if it has a detection of the type. It also does if about the type's own interval has
/// passed since the last frame that observed the type.
///
/// The type's own interval is the tenth of the gaps between its frames from below. A sensor of this rate has
/// hardly any shorter gap, but an agent that is often missed has many. Longer gaps are pauses.
fn observe(frames: &mut [Frame], interval_ns: u64) {
    for agent_type in AGENT_TYPES {
        let has = |frame: &Frame| frame.detections.iter().any(|d| d.agent_type == agent_type as u32);
        let stamps_ns: Vec<i64> =
            frames.iter().filter(|frame| has(frame)).map(|frame| frame.stamp_ns).collect();
        let mut gaps_ns: Vec<i64> = stamps_ns.windows(2).map(|pair| pair[1] - pair[0]).collect();
        gaps_ns.sort_unstable();
        let own_ns = gaps_ns.get(gaps_ns.len() / 10).copied().filter(|_| stamps_ns.len() >= RATE_FRAMES_MIN);
        let interval_ns = interval_ns as i64;
        let Some(own_ns) = own_ns.filter(|own_ns| *own_ns >= interval_ns + interval_ns * 3 / 4) else {
            continue;
        };
        let mut due_ns = i64::MIN;
        for frame in frames.iter_mut() {
            if frame.stamp_ns >= due_ns || has(frame) {
                due_ns = frame.stamp_ns + own_ns - interval_ns / 2;
            } else {
                frame.observed_types &= !agent_type.bit();
            }
        }
    }
}
