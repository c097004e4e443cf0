use std::collections::BTreeMap;
use std::sync::Arc;

use audit::{Audit, Doubt, Found, Place, TypeFigures, TypeNoise};
use serde::Serialize;
use wire::{Detection, detection_flags};

use crate::{BagTopic, Frame, LeftOut, Recording};

/// Maximum number of identities in the audit of a recording at the same time.
const IDENTITIES: usize = 4_096;
/// Speeds and headings up to these count as 0.
const ZEROS: [f32; 2] = [audit::NEAR_ZERO_MPS as f32, 0.0];
/// An interval between frames is a gap if it is longer than this number of half usual intervals.
const GAP: u64 = 5;

/// The content of a recording, and its probable errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Inspection {
    /// Name of the recording.
    pub recording: String,
    /// SHA-256 of its files.
    pub sha256: String,
    /// Frames.
    pub frames: usize,
    /// Detections.
    pub rows: u64,
    /// Time between the first and the last frame.
    pub span_s: f64,
    /// Usual interval between frames.
    pub interval_ms: f64,
    /// 5th and 95th percentile of the intervals; `None` with fewer than two frames.
    pub intervals_ms: Option<[f64; 2]>,
    /// Number of intervals longer than two and a half usual ones.
    pub gaps: usize,
    /// The longest gap.
    pub longest_gap: Option<Gap>,
    /// Whether all detections have identities.
    pub identities: bool,
    /// The topics of a bag, first those that are read.
    pub topics: Vec<BagTopic>,
    /// Frames with the pose of a sensor that agents can occlude.
    pub frames_with_ego: usize,
    /// Frames without a pose of a moving sensor near enough in time. They count as not seen from the sensor.
    pub poses_missing: usize,
    /// Statistics of each type.
    pub types: Vec<TypeInspection>,
    /// Share of the headings that agree with the motion; `None` without headings of moving agents.
    pub agreeing_headings: Option<f64>,
    /// Noise of the detections. Only a tracker learns it, so [`inspect`] leaves it empty.
    pub noise: Vec<TypeNoise>,
    /// Rows that the format leaves out, by reason.
    pub left_out: BTreeMap<String, usize>,
    /// All findings, whether they are doubts or not.
    pub findings: Vec<Found>,
}

/// A pause between frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Gap {
    /// Start of the pause, from the first frame.
    pub at_s: f64,
    /// Length of the pause.
    pub length_s: f64,
}

/// Statistics of a type.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TypeInspection {
    /// The type.
    #[serde(rename = "type")]
    pub agent_type: String,
    /// Detections.
    pub rows: u64,
    /// Number of agents: identities, or paths without identity.
    pub agents: u64,
    /// Median and 95th percentile of the speeds of moving agents, over a second or more.
    pub moving_mps: Option<[f64; 2]>,
    /// Median ratio of these speeds to the reported ones.
    pub reported_ratio: Option<f64>,
    /// Median length.
    pub length_m: Option<f64>,
}

/// Examines a recording.
#[must_use]
pub fn inspect(recording: &Recording) -> Inspection {
    let (audit, findings) = examine(recording);
    let stamps_ns = || recording.frames.iter().map(|frame| frame.stamp_ns);
    let mut intervals_ns: Vec<u64> =
        stamps_ns().zip(stamps_ns().skip(1)).map(|(from, to)| to.abs_diff(from)).collect();
    let first_ns = stamps_ns().next().unwrap_or(0);
    let gap_ns = recording.interval_ns * GAP / 2;
    let longest = intervals_ns.iter().copied().enumerate().max_by_key(|(_, ns)| *ns);
    let longest_gap = longest.filter(|(_, ns)| *ns > gap_ns).map(|(place, ns)| Gap {
        at_s: seconds(recording.frames[place].stamp_ns.abs_diff(first_ns)),
        length_s: seconds(ns),
    });
    let gaps = intervals_ns.iter().filter(|ns| **ns > gap_ns).count();
    intervals_ns.sort_unstable();
    let percentile = |percent: usize| {
        let last = intervals_ns.len().checked_sub(1)?;
        Some(milliseconds(intervals_ns[last * percent / 100]))
    };
    Inspection {
        recording: recording.name.clone(),
        sha256: recording.sha256.clone(),
        frames: recording.frames.len(),
        rows: audit.rows(),
        span_s: seconds(stamps_ns().next_back().unwrap_or(first_ns).abs_diff(first_ns)),
        interval_ms: milliseconds(recording.interval_ns),
        intervals_ms: percentile(5).zip(percentile(95)).map(|(low, high)| [low, high]),
        gaps,
        longest_gap,
        identities: recording.has_identities,
        topics: recording.topics.clone(),
        poses_missing: recording.poses_missing,
        frames_with_ego: recording.frames.iter().filter(|frame| frame.ego.is_sensor).count(),
        types: audit.types().map(TypeInspection::from).collect(),
        agreeing_headings: audit.agreeing_headings().map(rounded),
        noise: Vec::new(),
        left_out: recording
            .left_out
            .iter()
            .map(|LeftOut { reason, row_count }| (reason.clone(), *row_count))
            .collect(),
        findings,
    }
}

/// All findings on a recording, whether they are doubts or not; none for a generated scene.
#[must_use]
pub fn findings(recording: &Recording) -> Vec<Found> {
    if recording.sha256.is_empty() { Vec::new() } else { examine(recording).1 }
}

/// Removes the speeds and headings of a recording that stand for "unknown", because the motion contradicts them, and
/// keeps the findings about them.
pub(crate) fn drop_unknown(recording: &mut Recording) {
    let flags = [detection_flags::HAS_SPEED, detection_flags::HAS_HEADING];
    let value = |detection: &Detection, column: usize| [detection.speed_mps, detection.heading_rad][column];
    let detections = || recording.frames.iter().flat_map(|frame| &frame.detections);
    // Only zeros, or a column of one number, can stand for "unknown".
    let may_be_unknown = [0, 1].map(|column| {
        let mut values = detections().filter(|d| d.has(flags[column])).map(|d| value(d, column)).peekable();
        let first = values.peek().copied();
        let mut is_constant = first.is_some();
        values.any(|value| {
            is_constant &= Some(value) == first;
            value.abs() <= ZEROS[column]
        }) || is_constant
    });
    if may_be_unknown == [false; 2] {
        return;
    }
    let (audit, findings) = examine(recording);
    let unknown = audit.unknown();
    for (column, doubt) in [Doubt::SpeedsDiffer, Doubt::HeadingsUnrelated].into_iter().enumerate() {
        let Some(unknown) = unknown[column] else { continue };
        let found = findings.iter().find(|found| found.kind == doubt.name());
        recording.findings.extend(found.cloned());
        for frame in &mut recording.frames {
            for place in 0..frame.detections.len() {
                let written = frame.written(place).unwrap_or(frame.detections[place]);
                if written.has(flags[column]) && (value(&written, column) - unknown).abs() <= ZEROS[column] {
                    let detection = &mut frame.detections[place];
                    detection.flags &= !flags[column];
                    *(if column == 0 { &mut detection.speed_mps } else { &mut detection.heading_rad }) = 0.0;
                }
            }
        }
    }
}

fn examine(recording: &Recording) -> (Audit, Vec<Found>) {
    let mut audit = Audit::new(IDENTITIES, recording.frame_rate.map(|rate| rate.hertz()));
    let mut files = Files::default();
    for frame in &recording.frames {
        audit.frame();
        for (nth, detection) in frame.detections.iter().enumerate() {
            let stamp_ns = frame.stamp_ns + detection.offset_ns;
            let written = frame.written(nth).unwrap_or(*detection);
            audit.detection(stamp_ns, &written, files.place(frame, nth));
        }
    }
    let findings = audit.findings();
    let findings = findings.iter().map(|finding| finding.found(|place| files.name(place)));
    let findings = recording.findings.iter().cloned().chain(findings).collect();
    (audit, findings)
}

/// The files of a recording, by the number in a [`Place`].
#[derive(Default)]
struct Files<'a>(Vec<&'a Arc<str>>);

impl<'a> Files<'a> {
    /// The place of a frame's detection.
    fn place(&mut self, frame: &'a Frame, nth: usize) -> Place {
        let Some(line) = frame.lines.get(nth) else { return Place::default() };
        let file = self.0.iter().position(|path| Arc::ptr_eq(path, &line.path)).unwrap_or_else(|| {
            self.0.push(&line.path);
            self.0.len() - 1
        });
        Place { file: file as u32, line: line.line as u64 }
    }

    fn name(&self, place: Place) -> String {
        match self.0.get(place.file as usize) {
            Some(path) => format!("{path}:{}", place.line),
            None => format!("line {}", place.line),
        }
    }
}

impl From<TypeFigures> for TypeInspection {
    fn from(figures: TypeFigures) -> Self {
        Self {
            agent_type: figures.agent_type.name().to_owned(),
            rows: figures.rows,
            agents: figures.agents,
            moving_mps: figures.moving_mps.map(|speeds_mps| speeds_mps.map(rounded)),
            reported_ratio: figures.reported_ratio.map(rounded),
            length_m: figures.length_m.map(rounded),
        }
    }
}

/// Rounded to the thousandth.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn seconds(ns: u64) -> f64 {
    rounded(ns as f64 * 1e-9)
}

fn milliseconds(ns: u64) -> f64 {
    rounded(ns as f64 * 1e-6)
}
