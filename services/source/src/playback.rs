use data::{Ego, Frame, Recording};
use wire::{Counts, DETECTIONS_MAX, Detection, Header, InputCounts, StampSource, TICK_NS, Truth, flags};

use crate::thinning::{self, Played};

/// A recording may be faster than the tick rate by one part in this many before it is thinned. This allows
/// for clock drift.
const TOLERANCE: u64 = 50;

/// How a recording is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaybackOptions {
    /// Identifies the run.
    pub run_id: u64,
    /// Maximum number of ticks; `None` plays to the end.
    pub ticks_max: Option<u64>,
    /// Whether every stage waits for every tick.
    pub lockstep: bool,
}

/// The contents of one tick.
#[derive(Clone, Copy, Debug)]
pub struct Tick<'a> {
    /// The header of the detections, without hops.
    pub header: Header,
    /// At most [`DETECTIONS_MAX`] detections, in the recording's order.
    pub detections: &'a [Detection],
    /// At most [`DETECTIONS_MAX`] true positions; empty if the recording has none.
    pub truth: &'a [Truth],
    /// Time from the first tick to this one at the recording's own rate.
    pub due_ns: u64,
}

impl Tick<'_> {
    /// The header of the truth.
    pub fn truth_header(&self) -> Header {
        let mut header = self.header;
        header.counts.agents_len = self.truth.len() as u32;
        header.left_out_len = 0;
        header
    }
}

/// A recording as a sequence of ticks. Nothing is interpolated: a tick is a frame of the recording. It also
/// contains detections that other sensors made in the unplayed frames before it.
#[derive(Clone, Debug)]
pub struct Playback {
    recording: Recording,
    options: PlaybackOptions,
    /// Number of frames in the recording per played frame.
    thinning: u64,
    played: Played,
    /// Number of the next tick.
    seq: u64,
    left_out_len: u64,
    detections: Vec<Detection>,
    truth: Vec<Truth>,
    places: Vec<usize>,
}

impl Playback {
    /// Plays a recording from its start.
    #[must_use]
    pub fn new(mut recording: Recording, options: PlaybackOptions) -> Self {
        let interval_ns = recording.interval_ns.max(1);
        let thinning = (TICK_NS - TICK_NS / TOLERANCE).div_ceil(interval_ns).max(1);
        let mut played = thinning::thin(&mut recording, thinning);
        played.places.truncate(
            options.ticks_max.map_or(usize::MAX, |most| usize::try_from(most).unwrap_or(usize::MAX)),
        );
        let fullest = |len: fn(&Frame) -> usize| recording.frames.iter().map(len).max().unwrap_or(0);
        let place_count = fullest(|frame| frame.detections.len()).max(fullest(|frame| frame.truth.len()));
        Self {
            recording,
            options,
            thinning,
            played,
            seq: 0,
            left_out_len: 0,
            detections: Vec::with_capacity(DETECTIONS_MAX),
            truth: Vec::with_capacity(DETECTIONS_MAX),
            places: Vec::with_capacity(place_count),
        }
    }

    /// The recording that is played.
    pub const fn recording(&self) -> &Recording {
        &self.recording
    }

    /// The number of ticks in the whole playback.
    pub fn tick_count(&self) -> u64 {
        self.played.places.len() as u64
    }

    /// The number of recorded frames per played frame: 1 unless the recording is faster than 12.5 Hz.
    pub const fn thinning(&self) -> u64 {
        self.thinning
    }

    /// The planned interval between ticks.
    pub const fn interval_ns(&self) -> u64 {
        self.recording.interval_ns * self.thinning
    }

    /// The number of detections left out so far because their frame was full.
    pub const fn left_out_len(&self) -> u64 {
        self.left_out_len
    }

    /// Returns the next tick; `None` after the last.
    ///
    /// If a frame has more than [`DETECTIONS_MAX`] detections, the detections with the best scores go out.
    /// Among equal scores, the nearest to the ego go out. The header counts the others.
    pub fn next_tick(&mut self) -> Option<Tick<'_>> {
        let frame = &self.recording.frames[*self.played.places.get(usize::try_from(self.seq).ok()?)?];
        let first_ns = self.recording.frames[self.played.places[0]].stamp_ns;
        let mut header = self.header(self.seq, frame);
        let left_out_len = frame.detections.len().saturating_sub(DETECTIONS_MAX);
        header.left_out_len = left_out_len as u32;
        header.counts.agents_len = (frame.detections.len() - left_out_len) as u32;
        self.left_out_len += left_out_len as u64;
        self.seq += 1;

        let ego = frame.ego;
        let best = |d: &Detection| (-d.score, distance_m(ego, d.x_m, d.y_m));
        let nearest = |t: &Truth| (0.0, distance_m(ego, t.x_m, t.y_m));
        Some(Tick {
            header,
            detections: at_most(&frame.detections, best, &mut self.places, &mut self.detections),
            truth: at_most(&frame.truth, nearest, &mut self.places, &mut self.truth),
            due_ns: frame.stamp_ns.abs_diff(first_ns),
        })
    }

    /// Skips to the first tick that is due at `due_ns` or later and has a number of at least `seq`.
    pub fn skip_to(&mut self, due_ns: u64, seq: u64) {
        let Some(&first) = self.played.places.first() else { return };
        let first_ns = self.recording.frames[first].stamp_ns;
        let is_before = |&place: &usize| self.recording.frames[place].stamp_ns.abs_diff(first_ns) < due_ns;
        let due_len = self.played.places.partition_point(is_before) as u64;
        self.seq = self.seq.max(due_len).max(seq).min(self.tick_count());
    }

    /// The header of the frame that links the stages before the first tick.
    pub fn warm_up(&self) -> Header {
        let first = self.played.places.first().map(|&first| &self.recording.frames[first]);
        let header =
            first.map_or_else(|| Header::new(self.options.run_id, 0, 0), |first| self.header(0, first));
        Header { flags: header.flags | flags::WARM_UP, ..header }
    }

    /// The header of the end frame, after which no tick follows. Its stamp is one interval after the last
    /// tick's stamp.
    pub fn end(&self) -> Header {
        let sent = usize::try_from(self.seq).unwrap_or(usize::MAX).min(self.played.places.len());
        let last = sent.checked_sub(1).map(|last| &self.recording.frames[self.played.places[last]]);
        let header =
            last.map_or_else(|| Header::new(self.options.run_id, 0, 0), |last| self.header(self.seq, last));
        let interval_ns = i64::try_from(self.interval_ns()).unwrap_or(i64::MAX);
        Header {
            flags: header.flags | flags::END,
            stamp_ns: header.stamp_ns.saturating_add(interval_ns),
            ..header
        }
    }

    /// The source of the stamps. Only generated scenes have no file.
    const fn stamp_source(&self) -> StampSource {
        if self.recording.sha256.is_empty() { StampSource::Generated } else { StampSource::Recording }
    }

    /// The header of a frame, without counts.
    fn header(&self, seq: u64, frame: &Frame) -> Header {
        let place =
            usize::try_from(seq).unwrap_or(usize::MAX).min(self.played.counts.len().saturating_sub(1));
        let [unplayed, merged] = self.played.counts.get(place).copied().unwrap_or_default();
        let identities = if self.recording.has_identities { flags::HAS_IDENTITIES } else { 0 };
        let lockstep = if self.options.lockstep { flags::LOCKSTEP } else { 0 };
        let from_ego = if frame.ego.is_sensor { flags::SEEN_FROM_EGO } else { 0 };
        Header {
            flags: identities | lockstep | from_ego,
            interval_ns: self.interval_ns(),
            stamp_source: self.stamp_source() as u32,
            observed_types: frame.observed_types,
            ego_m: frame.ego.position_m,
            ego_heading_rad: frame.ego.heading_rad,
            counts: Counts::default(),
            input: InputCounts { unplayed, merged, ..InputCounts::default() },
            ..Header::new(self.options.run_id, seq, frame.stamp_ns)
        }
    }
}

fn distance_m(ego: Ego, x_m: f32, y_m: f32) -> f32 {
    (x_m - ego.position_m[0]).hypot(y_m - ego.position_m[1])
}

/// Returns at most [`DETECTIONS_MAX`] items: those with the lowest ranks, in their original order.
fn at_most<'a, T: Copy>(
    items: &'a [T],
    rank: impl Fn(&T) -> (f32, f32),
    places: &mut Vec<usize>,
    kept: &'a mut Vec<T>,
) -> &'a [T] {
    if items.len() <= DETECTIONS_MAX {
        return items;
    }
    places.clear();
    places.extend(0..items.len());
    places.select_nth_unstable_by(DETECTIONS_MAX, |&a, &b| {
        let [left, right] = [rank(&items[a]), rank(&items[b])];
        left.0.total_cmp(&right.0).then(left.1.total_cmp(&right.1)).then(a.cmp(&b))
    });
    places.truncate(DETECTIONS_MAX);
    places.sort_unstable();
    kept.clear();
    kept.extend(places.iter().map(|&place| items[place]));
    kept
}

#[cfg(test)]
mod tests {
    use wire::AgentType;

    use super::*;

    fn detection(x_m: f32, score: f32) -> Detection {
        Detection {
            id: x_m as u64,
            x_m,
            score,
            agent_type: AgentType::Pedestrian as u32,
            ..Detection::default()
        }
    }

    fn recording(interval_ns: u64, stamps_ns: &[i64]) -> Recording {
        let frame = |&stamp_ns| Frame {
            stamp_ns,
            observed_types: AgentType::Pedestrian.bit(),
            detections: vec![detection(1.0, 1.0)],
            ..Frame::default()
        };
        let frames = stamps_ns.iter().map(frame).collect();
        Recording { interval_ns, has_identities: true, frames, ..Recording::default() }
    }

    fn stamps_ms(playback: &mut Playback) -> Vec<i64> {
        std::iter::from_fn(|| playback.next_tick().map(|tick| tick.header.stamp_ns / 1_000_000)).collect()
    }

    #[test]
    fn a_slow_recording_is_played_whole() {
        let stamps: Vec<i64> = (0..5).map(|k| k * 100_000_000).collect();
        let mut playback = Playback::new(recording(100_000_000, &stamps), PlaybackOptions::default());
        assert_eq!((playback.thinning(), playback.interval_ns()), (1, 100_000_000));
        assert_eq!(stamps_ms(&mut playback), [0, 100, 200, 300, 400]);
        assert!(playback.next_tick().is_none());
    }

    #[test]
    fn a_fast_recording_is_thinned_by_whole_frames() {
        // 30 Hz without frames 4 and 5. Every third frame gives 10 Hz.
        let stamps: Vec<i64> =
            (0..12).filter(|k| ![4, 5].contains(k)).map(|k| k * 1_000_000_000 / 30).collect();
        let mut playback = Playback::new(recording(33_333_333, &stamps), PlaybackOptions::default());
        assert_eq!(playback.thinning(), 3);
        assert_eq!(stamps_ms(&mut playback), [0, 100, 200, 300]);
    }

    #[test]
    fn a_recording_of_12_5_hz_with_clock_drift_is_not_thinned() {
        let stamps: Vec<i64> = (0..4).map(|k| k * 79_900_000).collect();
        let playback = Playback::new(recording(79_900_000, &stamps), PlaybackOptions::default());
        assert_eq!(playback.thinning(), 1);
    }

    #[test]
    fn stamps_come_from_a_recording_or_a_generated_scene() {
        let generated = recording(80_000_000, &[0]);
        let recorded = Recording { sha256: "5a".repeat(32), ..generated.clone() };
        for (played, expected) in [(generated, StampSource::Generated), (recorded, StampSource::Recording)] {
            let mut playback = Playback::new(played, PlaybackOptions::default());
            let headers =
                [playback.warm_up(), playback.next_tick().expect("there is a tick").header, playback.end()];
            assert!(headers.iter().all(|header| header.stamp_source == expected as u32));
        }
    }

    #[test]
    fn ticks_are_numbered_and_due_after_the_first() {
        let options = PlaybackOptions { run_id: 9, ticks_max: Some(2), lockstep: true };
        let mut playback =
            Playback::new(recording(400_000_000, &[52_000_000_000, 52_400_000_000, 60_000_000_000]), options);
        assert_eq!(playback.tick_count(), 2);
        assert!(playback.warm_up().has(flags::WARM_UP));
        playback.next_tick();
        let tick = playback.next_tick().unwrap();
        assert_eq!((tick.header.run_id, tick.header.seq, tick.due_ns), (9, 1, 400_000_000));
        assert!(tick.header.has(flags::HAS_IDENTITIES | flags::LOCKSTEP));
        assert_eq!(tick.header.counts.agents_len, 1);
        tick.header.check().unwrap();
        let end = playback.end();
        assert_eq!((end.seq, end.stamp_ns, end.is_tick()), (2, 52_800_000_000, false));
    }

    #[test]
    fn a_full_frame_keeps_the_best_scores_then_the_nearest() {
        let mut full = recording(100_000_000, &[0]);
        full.frames[0].detections =
            (0..DETECTIONS_MAX + 10).map(|k| detection(k as f32, if k < 5 { 0.1 } else { 0.9 })).collect();
        let mut playback = Playback::new(full, PlaybackOptions::default());
        let tick = playback.next_tick().unwrap();
        assert_eq!(tick.header.left_out_len, 10);
        assert_eq!(tick.detections.len(), DETECTIONS_MAX);
        let kept: Vec<u64> = tick.detections.iter().map(|d| d.id).collect();
        let expected: Vec<u64> = (5..5 + DETECTIONS_MAX as u64).collect();
        assert_eq!(kept, expected);
        assert_eq!(playback.left_out_len(), 10);
    }

    #[test]
    fn an_empty_recording_has_no_tick() {
        let mut playback = Playback::new(recording(0, &[]), PlaybackOptions::default());
        assert!(playback.next_tick().is_none());
        assert_eq!(playback.end().seq, 0);
    }
}
