//! The report of a run as one HTML file that needs no network.
//!
//! The file contains the report as JSON and, if the run was recorded, data that the page unpacks: the times and
//! qualities of the ticks, the scenes of the worst ticks, errors by horizon, and the scene over the whole run.
//! The size of the file is bounded for any length of the run: parts are thinned until they have their share of
//! [`PAGE_BYTES`].

mod errors;
mod scrub;
mod series;

use std::collections::{BTreeMap, BTreeSet};

use lanes::LaneMap;
use recorder::{Recorder, RecorderOptions, Report, WorstTick};
use recording::{About, Frame, FrameError, Message, ReadError, Recording};
use serde::Serialize;
use wire::tick_view::TickView;
use wire::{ForecastsTopic, HeartbeatsTopic, StageId, Topic as _, TruthTopic};

use self::errors::{ErrorRow, HorizonErrors};
use self::scrub::{Scrub, deflate};
use self::series::Series;
use crate::{MODES_DRAWN, Pairing, Scene, page};

/// Maximum size of a page with one or two runs.
pub const PAGE_BYTES: usize = 1_000_000;
/// Share of the page for the scene over the whole run, before base64.
const SCRUB_BYTES: usize = 380_000;
/// Share of the page for all other data of the run, before base64.
const DETAIL_BYTES: usize = 160_000;
/// Number of worst ticks that are drawn.
const WORST_DRAWN: usize = 6;
/// Bounds of lanes with more points than this are not embedded.
const LANE_POINTS_MAX: usize = 4_000;
/// Number of agents and events that the page lists.
const LISTED_MAX: usize = 100;

/// A run on a page.
#[derive(Debug)]
pub struct RunPage {
    name: String,
    report: Report,
    details: Option<Box<Details>>,
}

/// What only a recording of the run contains.
#[derive(Debug, Default)]
struct Details {
    series: Series,
    errors: HorizonErrors,
    scrub: Scrub,
    worst: BTreeMap<u64, TickView>,
    lanes: String,
    /// Options that decide about forecasts, by stage and name.
    options: BTreeMap<String, String>,
}

/// The details as the page reads them.
#[derive(Serialize)]
struct Embedded<'a> {
    series: &'a Series,
    errors: Vec<ErrorRow>,
    worst: BTreeMap<u64, Scene>,
}

impl RunPage {
    /// A run of which there is only the report.
    #[must_use]
    pub const fn of_report(name: String, report: Report) -> Self {
        Self { name, report, details: None }
    }

    /// A recorded run. Without a `report`, the report is measured from the recording; it then has no errors
    /// unless the truth was recorded. Also returns the damaged parts of the file.
    #[must_use]
    pub fn of_recording(
        name: String,
        recording: &Recording,
        report: Option<Report>,
        lanes: Option<&LaneMap>,
    ) -> (Self, Vec<ReadError>) {
        let mut gathering = Gathering::new(recording);
        let mut damages = Vec::new();
        for message in recording.messages() {
            // A refused frame is counted by the recorder, as its readers did.
            match message {
                Ok(message) => drop(gathering.take(&message)),
                Err(error) => damages.push(error),
            }
        }
        let Gathering { recorder, mut details, .. } = gathering;
        let report = report.unwrap_or_else(|| {
            let mut report = recorder.report();
            known(&mut report, recording.about());
            report
        });
        let wanted: BTreeSet<u64> = drawn(&report).map(|worst| worst.tick).collect();
        details.worst = scenes(recording, &wanted);
        let about = recording.about();
        details.options = options_of(about);
        details.options.insert("kernels".to_owned(), about.kernels.clone());
        details.lanes =
            lanes.filter(|map| points_len(map) <= LANE_POINTS_MAX).map(crate::lanes_json).unwrap_or_default();
        (Self { name, report, details: Some(Box::new(details)) }, damages)
    }

    /// The run's part of the page's data, as JSON.
    fn json(&self, runs: usize) -> String {
        let mut report = self.report.clone();
        report.accuracy.agents.truncate(LISTED_MAX);
        report.supervision.outages.truncate(LISTED_MAX);
        let mut data = serde_json::json!({ "name": self.name, "report": report });
        if let Some(details) = &self.details {
            data["details"] = details.packed(DETAIL_BYTES / runs).into();
            data["scrub"] = base64(&details.scrub.packed(SCRUB_BYTES / runs)).into();
            data["options"] = serde_json::json!(details.options);
            data["every"] = details.scrub.every(SCRUB_BYTES / runs).into();
            data["lanes"] = serde_json::from_str(&details.lanes).unwrap_or_default();
        }
        data.to_string()
    }
}

/// Adds the facts of the run that its recording contains to a report that was measured from it.
fn known(report: &mut Report, about: &About) {
    let given = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    report.run.recording.get_or_insert_with(|| about.scene.clone());
    report.run.seed.get_or_insert(about.run.seed);
    report.run.weights_sha256 = report.run.weights_sha256.take().or_else(|| given(&about.weights_sha256));
    // The build of the run, not the one that reads the recording.
    if let Some(version) = given(about.program.trim_start_matches("stgdat ")) {
        report.stgdat_version = version;
    }
}

/// The options of the stages before the recorder, by stage and name. Paths in the run's own directory are left out; a
/// played recording has none.
#[must_use]
pub fn options_of(about: &About) -> BTreeMap<String, String> {
    let run = &about.run;
    let root = run.root.to_string_lossy();
    let mut options = BTreeMap::new();
    for stage in &run.stages {
        let Some(id) = StageId::from_number(stage.stage).filter(|id| *id != StageId::Recorder) else {
            continue;
        };
        let pairs = stage.options.lines().filter_map(|line| line.split_once(" = "));
        let pairs = pairs.filter(|(_, value)| root.is_empty() || !value.contains(&*root));
        options.extend(pairs.map(|(name, value)| (format!("{}.{name}", id.name()), value.to_owned())));
    }
    options
}

fn points_len(map: &LaneMap) -> usize {
    map.lanes().iter().flat_map(|lane| lane.bounds_m.iter()).map(Vec::len).sum()
}

/// The worst ticks that have a scene.
fn drawn(report: &Report) -> impl Iterator<Item = &WorstTick> {
    report.worst_ticks.iter().take(WORST_DRAWN)
}

/// The scenes of ticks. For a tick without forecasts, the next tick with forecasts.
fn scenes(recording: &Recording, wanted: &BTreeSet<u64>) -> BTreeMap<u64, TickView> {
    let mut pairing = Pairing::default();
    let mut found = BTreeMap::new();
    let mut missing = wanted.clone();
    for message in recording.messages().flatten() {
        if let Message::Frame(frame) = message
            && let Some((view, _)) = pairing.take(frame)
        {
            // Ticks up to this one that are still missing have no forecasts of their own.
            let rest = missing.split_off(&(view.seq + 1));
            for seq in std::mem::replace(&mut missing, rest) {
                found.insert(seq, view.clone());
            }
        }
        if missing.is_empty() {
            break;
        }
    }
    found
}

/// Reads a recording once.
struct Gathering {
    recorder: Recorder,
    pairing: Pairing,
    details: Details,
}

impl Gathering {
    fn new(recording: &Recording) -> Self {
        let run = &recording.about().run;
        let mut options =
            RecorderOptions { scores: recording.has_topic(TruthTopic::NAME), ..RecorderOptions::of(run) };
        if run.stages.is_empty() {
            options.stages = StageId::ALL.to_vec();
        }
        let mut recorder = Recorder::new(options);
        // Frames of `predict` have no clock.
        if recording.about().clock_offset_ns != 0 {
            recorder.set_clock_offset(recording.about().clock_offset_ns);
        }
        Self { recorder, pairing: Pairing::default(), details: Details::default() }
    }

    fn take(&mut self, message: &Message) -> Result<(), FrameError> {
        let Message::Frame(frame) = message else { return Ok(()) };
        match frame.topic().name {
            ForecastsTopic::NAME => {
                let forecasts = frame.elements::<ForecastsTopic>()?;
                if let Ok(Some(tick)) = self.recorder.forecasts(frame.header(), &forecasts) {
                    self.details.series.add(frame.header(), &tick);
                }
                self.view(frame);
            }
            HeartbeatsTopic::NAME => {
                frame.elements::<HeartbeatsTopic>()?.iter().for_each(|beat| self.recorder.heartbeat(beat));
            }
            TruthTopic::NAME => {
                let truth = frame.elements::<TruthTopic>()?;
                // A refused frame changes nothing.
                let _ = self.recorder.truth(frame.header(), &truth);
            }
            _ => self.view(frame),
        }
        Ok(())
    }

    fn view(&mut self, frame: &Frame) {
        if let Some((view, _)) = self.pairing.take(frame.clone()) {
            self.details.scrub.add(&view);
            self.details.errors.add(view);
        }
    }
}

impl Details {
    /// The details as packed JSON of at most about `limit` bytes: if they are larger, the worst ticks lose
    /// their modes, then their number is halved.
    fn packed(&self, limit: usize) -> String {
        let mut series = self.series.clone();
        let mut choices =
            [(MODES_DRAWN, WORST_DRAWN), (6, WORST_DRAWN), (0, WORST_DRAWN), (0, 2), (0, 0)].into_iter();
        loop {
            let choice = choices.next();
            let (modes, scenes) = choice.unwrap_or_default();
            let worst = self.worst.iter().take(scenes).map(|(seq, view)| (*seq, Scene::new(view, modes)));
            let embedded = Embedded { series: &series, errors: self.errors.rows(), worst: worst.collect() };
            let json = serde_json::to_vec(&embedded).unwrap_or_default();
            let packed = deflate(&json);
            if packed.len() <= limit || series.len() < 2 {
                return base64(&packed);
            }
            if choice.is_none() {
                series.halve();
            }
        }
    }
}

/// The page of one run, or of two side by side.
#[must_use]
pub fn html(runs: &[RunPage]) -> String {
    let data: Vec<String> = runs.iter().map(|run| run.json(runs.len())).collect();
    // No text can end the script or begin a comment.
    let data = format!("const RUNS = [{}];\n", data.join(",\n").replace('<', "\\u003c"));
    let scripts = [data.as_str(), include_str!("../assets/compare.js"), include_str!("../assets/report.js")];
    page(include_str!("../assets/report.html"), &scripts)
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for part in bytes.chunks(3) {
        let bits = (0..3).fold(0, |bits, at| bits << 8 | u32::from(part.get(at).copied().unwrap_or(0)));
        for digit in 0..4 {
            let is_padding = digit > part.len();
            let value = DIGITS[(bits >> (18 - 6 * digit) & 63) as usize];
            text.push(if is_padding { '=' } else { char::from(value) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_become_base64() {
        let texts = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg==")];
        for (bytes, text) in texts {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn no_text_of_a_run_ends_the_script() {
        let name = "</script><script>alert(1)</script><!--".to_owned();
        let html = html(&[RunPage::of_report(name, Report::default())]);
        assert_eq!(html.matches("</script").count(), 11);
        assert!(html.len() < 120_000 && !html.contains("alert(1)</script"));
    }
}
