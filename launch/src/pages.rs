//! The report pages of runs, and of recordings that are played in this process.

use std::path::{Path, PathBuf};

use console::failure::Failure;
use nn::ModelConfig;
use onboard::Chain;
use recorder::{Report, WholeFile};
use recording::{About, Frame, ReadError, Recording, Writer};
use run::Run;
use source::{Playback, PlaybackOptions, Tick};
use view::RunPage;
use wire::{ForecastsTopic, Topic as _, TracksTopic, TruthTopic};

use crate::arguments::lanes_of;
use crate::files::check_new;
use crate::recorded;
use crate::verbs::wire::layout;

/// Writes the page of one or two runs. Returns the damaged parts of their recordings.
///
/// # Errors
/// [`Failure`] if a file is not the report or recording of a run, or the page can't be written.
pub fn write_page(path: &Path, files: &[&Path]) -> Result<Vec<ReadError>, Failure> {
    let mut damages = Vec::new();
    let mut runs = Vec::new();
    for file in files {
        let (run, damaged) = load(file)?;
        runs.push(run);
        damages.extend(damaged);
    }
    write(path, &runs)?;
    Ok(damages)
}

/// Reads a report or a recording. A recording takes its report from the file of the same name that ends in
/// json, if there is one.
fn load(path: &Path) -> Result<(RunPage, Vec<ReadError>), Failure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json")) {
        let report = Report::read(path).map_err(Failure::data)?;
        return Ok((RunPage::of_report(name, report), Vec::new()));
    }
    let recording = recorded::open(path)?;
    let beside = path.with_extension("json");
    let report = if beside.exists() { report_beside(&beside, recording.about()) } else { None };
    Ok(page_of(name, &recording, report))
}

/// The report beside a recording. Anything but the report of this run is left out with a warning.
fn report_beside(path: &Path, about: &About) -> Option<Report> {
    let report = Report::read(path).map_err(|error| error.to_string());
    let report = report.and_then(|report| match is_of_run(&report, about) {
        true => Ok(report),
        false => Err(format!("{}: the report of another run", path.display())),
    });
    report.inspect_err(|why| tracing::warn!("{why}: the figures are measured from the recording")).ok()
}

/// Whether a report is of a recorded run. Reports of earlier versions have no number of the run; their scene
/// and seed are compared.
fn is_of_run(report: &Report, about: &About) -> bool {
    let info = &report.run;
    match &info.run_id {
        Some(id) => *id == format!("{:016x}", about.run.id),
        None => {
            info.recording.as_ref().is_none_or(|name| *name == about.scene)
                && info.seed.is_none_or(|seed| seed == about.run.seed)
        }
    }
}

/// The page of a recorded run. A map of lanes that has moved since is left out.
fn page_of(name: String, recording: &Recording, report: Option<Report>) -> (RunPage, Vec<ReadError>) {
    let lanes = lanes_of(&recording.about().run).unwrap_or_else(|failure| {
        tracing::warn!("{failure}: the page has no lanes");
        None
    });
    RunPage::of_recording(name, recording, report, lanes.as_ref())
}

/// The page that a run writes at its end, from a recording of the run.
#[derive(Debug)]
pub(crate) struct RunReport {
    path: PathBuf,
    recording: PathBuf,
    /// Whether the recording is made for the page alone.
    is_temporary: bool,
}

impl RunReport {
    /// Checks that the page can be written, and does not exist unless `force` permits to replace it. Without a `recording`, the run is recorded beside the page.
    pub fn new(path: &Path, recording: Option<&Path>, force: bool) -> Result<Self, Failure> {
        check_new(path, force)?;
        let own = || {
            let mut name = path.as_os_str().to_owned();
            name.push(format!(".{}.mcap", std::process::id()));
            PathBuf::from(name)
        };
        let is_temporary = recording.is_none();
        Ok(Self {
            path: path.to_owned(),
            recording: recording.map_or_else(own, Path::to_owned),
            is_temporary,
        })
    }

    /// The recording that the run makes.
    pub fn recording(&self) -> &Path {
        &self.recording
    }

    /// Writes the page. Without a `report` it is measured from the recording.
    pub fn write(&self, report: Option<Report>) -> Result<(), Failure> {
        let recording = Recording::open(&self.recording).map_err(Failure::data)?;
        let name = report.as_ref().and_then(|report| report.run.recording.clone());
        let name = name.unwrap_or_else(|| recording.about().scene.clone());
        let (run, damages) = page_of(name, &recording, report);
        write(&self.path, &[run])?;
        recorded::end_with(damages).map(drop)
    }
}

impl Drop for RunReport {
    fn drop(&mut self) {
        if self.is_temporary {
            let _ = std::fs::remove_file(&self.recording);
        }
    }
}

/// Plays a recording through all stages in this process, and records tracks, forecasts and truth.
///
/// # Errors
/// [`Failure`] if the model does not fit the run, or the file can't be written.
pub fn record_played(
    recording: data::Recording,
    run: &Run,
    model: &ModelConfig,
    path: &Path,
) -> Result<(), Failure> {
    let name = recording.name.clone();
    let options = PlaybackOptions { lockstep: true, ..PlaybackOptions::default() };
    let mut playback = Playback::new(recording, options);
    let run = Run { interval_ns: playback.interval_ns(), ..run.clone() };
    let mut played = PlayedRecording::create(path, &name, &run)?;
    let mut chain = Chain::new(&run, model)?;
    while let Some(tick) = playback.next_tick() {
        chain.tick(&tick.header, tick.detections, |_| ());
        played.add(&tick, &chain);
    }
    played.finish()
}

/// The frames of a recording that is played in this process.
#[derive(Debug)]
struct PlayedRecording(Writer);

impl PlayedRecording {
    fn create(path: &Path, name: &str, run: &Run) -> Result<Self, Failure> {
        let topics = [TracksTopic::NAME, ForecastsTopic::NAME, TruthTopic::NAME].map(str::to_owned).to_vec();
        let about = About { scene: name.to_owned(), run: run.clone(), topics, ..About::default() };
        Ok(Self(Writer::create(path, &about, &layout()).map_err(Failure::data)?))
    }

    /// Adds the frames of a tick that the chain has answered.
    fn add(&mut self, tick: &Tick<'_>, chain: &Chain) {
        let (tracks, forecasts) = chain.frames();
        if tracks.header.has(wire::flags::VOID) {
            return;
        }
        // A page of frames without a clock has no latencies, and only the order counts.
        let at_ns = tick.due_ns;
        if !tick.truth.is_empty() {
            self.0.frame(&Frame::of::<TruthTopic>(&tick.truth_header(), tick.truth, at_ns));
        }
        self.0.frame(&Frame::of::<TracksTopic>(&tracks.header, &tracks.elements, at_ns));
        self.0.frame(&Frame::of::<ForecastsTopic>(&forecasts.header, &forecasts.elements, at_ns));
    }

    fn finish(self) -> Result<(), Failure> {
        self.0.finish("played").map(drop).map_err(Failure::data)
    }
}

/// The page of a recording that is played in this process.
#[derive(Debug)]
pub(crate) struct PlayedPage {
    page: RunReport,
    recording: PlayedRecording,
}

impl PlayedPage {
    /// Checks that the page can be written, as [`RunReport::new`] does.
    pub fn new(path: &Path, name: &str, run: &Run, force: bool) -> Result<Self, Failure> {
        let page = RunReport::new(path, None, force)?;
        let recording = PlayedRecording::create(page.recording(), name, run)?;
        Ok(Self { page, recording })
    }

    /// Adds the frames of a tick that the chain has answered.
    pub fn add(&mut self, tick: &Tick<'_>, chain: &Chain) {
        self.recording.add(tick, chain);
    }

    /// Writes the page.
    pub fn write(self) -> Result<(), Failure> {
        self.recording.finish()?;
        self.page.write(None)
    }
}

fn write(path: &Path, runs: &[RunPage]) -> Result<(), Failure> {
    use std::io::Write as _;
    let failed = |error| Failure::file(path, error);
    let mut file = WholeFile::create(path).map_err(failed)?;
    file.write_all(view::html(runs).as_bytes()).and_then(|()| file.finish()).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_belongs_to_its_own_run_alone() {
        let mut about = About { scene: "a".to_owned(), ..About::default() };
        (about.run.id, about.run.seed) = (0xab, 7);
        let report = |run_id: Option<&str>, name: &str, seed| {
            let mut report = Report::default();
            report.run.run_id = run_id.map(str::to_owned);
            (report.run.recording, report.run.seed) = (Some(name.to_owned()), seed);
            report
        };
        let is = |run_id, name, seed| is_of_run(&report(run_id, name, seed), &about);
        assert!(is(Some("00000000000000ab"), "b", Some(8)), "the number decides");
        assert!(!is(Some("00000000000000ac"), "a", Some(7)));
        assert!(is(None, "a", Some(7)) && is(None, "a", None));
        assert!(!is(None, "b", Some(7)) && !is(None, "a", Some(8)));

        let folder = tempfile::tempdir().unwrap();
        let beside = folder.path().join("a.json");
        std::fs::write(&beside, "{}").unwrap();
        assert!(report_beside(&beside, &about).is_none(), "not a report");
        report(Some("1"), "a", None).write(&beside).unwrap();
        assert!(report_beside(&beside, &about).is_none());
        report(Some("00000000000000ab"), "a", None).write(&beside).unwrap();
        assert!(report_beside(&beside, &about).is_some());
    }
}
