use crate::doubt::Doubt;
use crate::finding::{Detail, Finding, INTERVAL_MAX_S};
use crate::tally::{Place, Tally};

const SECOND_NS: i64 = 1_000_000_000;
/// Smallest number of intervals.
const INTERVALS_MIN: u64 = 20;
/// Shortest interval of a real sensor.
const INTERVAL_MIN_S: f64 = 0.001;
/// Interval between frames over which agents without identities can't be followed, and smallest number of intervals.
const SPARSE_S: f64 = 2.2;
const FRAMES_MIN: u64 = 8;
/// Longest interval between frame numbers, in frames.
const FRAMES_MAX: f64 = 20.0;

/// Intervals between the detections of an agent.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stamps {
    /// Counts by the position of the highest bit.
    counts: Octaves,
    rows: u64,
    /// Rows whose stamp is a whole second.
    whole: u64,
    intervals: Tally,
    /// The newest frame with a detection and its first stamp, and the intervals between frames.
    frame: Option<(u64, i64)>,
    frame_counts: Octaves,
    frame_intervals: u64,
}

/// Number and sum of intervals by octave.
#[derive(Clone, Debug)]
struct Octaves([(u64, f64); 64]);

impl Default for Octaves {
    fn default() -> Self {
        Self([(0, 0.0); 64])
    }
}

impl Octaves {
    fn add(&mut self, interval_ns: i64) {
        let octave = &mut self.0[interval_ns.max(1).ilog2() as usize];
        *octave = (octave.0 + 1, octave.1 + interval_ns as f64);
    }

    /// The median of this number of intervals, as the mean of its octave.
    fn median_s(&self, len: u64) -> Option<f64> {
        let mut before = 0;
        let median = self.0.iter().find(|(count, _)| {
            before += count;
            2 * before > len
        });
        median.map(|(count, sum_ns)| sum_ns / *count as f64 * 1e-9)
    }
}

impl Stamps {
    pub fn row(&mut self, stamp_ns: i64, frame: u64) {
        match self.frame {
            Some((newest, _)) if newest == frame => {}
            before => {
                if let Some((_, before_ns)) = before {
                    self.frame_counts.add(stamp_ns.saturating_sub(before_ns));
                    self.frame_intervals += 1;
                }
                self.frame = Some((frame, stamp_ns));
            }
        }
        self.rows += 1;
        self.whole += u64::from(stamp_ns % SECOND_NS == 0);
    }

    /// Adds the time between two detections of an agent.
    pub fn interval(&mut self, interval_ns: i64, place: Place) {
        self.intervals.add(1, place);
        self.counts.add(interval_ns);
    }

    /// Whether the stamps of all rows are whole seconds.
    pub const fn are_whole(&self) -> bool {
        self.whole == self.rows
    }

    /// The usual interval between frames, if agents without identities can't be followed over it.
    pub fn sparse_s(&self) -> Option<f64> {
        let interval_s = self.frame_counts.median_s(self.frame_intervals)?;
        let is_sparse = (SPARSE_S..=INTERVAL_MAX_S).contains(&interval_s);
        (is_sparse && self.frame_intervals >= FRAMES_MIN).then_some(interval_s)
    }

    /// Passes the faults of the stamps to `take`. `is_known` is set if speeds confirm that they are seconds.
    pub fn visit(&self, is_known: bool, rows: u64, take: &mut impl FnMut(Finding)) {
        let Some(interval_s) =
            self.counts.median_s(self.intervals.rows).filter(|_| self.intervals.rows >= INTERVALS_MIN)
        else {
            return;
        };
        let detail = Detail::Interval { interval_s };
        let all = Tally { rows, first: self.intervals.first };
        if self.are_whole() && (0.5..=FRAMES_MAX - 1e-9).contains(&interval_s) && !is_known {
            take(Finding::new(Doubt::StampsAreFrames, all, rows, detail));
        } else if !(INTERVAL_MIN_S..=INTERVAL_MAX_S).contains(&interval_s) {
            take(Finding::new(Doubt::StampsInOtherUnit, all, rows, detail));
        }
    }
}
