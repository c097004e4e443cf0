use std::path::{Path, PathBuf};

use clap::Args;
use recorder::{Report, WholeFile};
use recording::{ReadError, Recording};
use run::Exit;
use view::RunPage;

use crate::arguments::{check_place, lanes_of};
use crate::failure::Failure;
use crate::recorded;

/// Arguments of `stgdat report`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Report of a run (`run --report`), or recording of a run (`run --record`)
    run: PathBuf,
    /// Another run, to be shown beside the first
    other: Option<PathBuf>,
    /// The page; by default named after the first file, with the ending html
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Writes the report of one or two runs as an HTML page.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let mut damages = Vec::new();
    let mut runs = Vec::new();
    for path in [Some(&arguments.run), arguments.other.as_ref()].into_iter().flatten() {
        let (run, damaged) = load(path)?;
        runs.push(run);
        damages.extend(damaged);
    }
    let path = arguments.out.clone().unwrap_or_else(|| arguments.run.with_extension("html"));
    write(&path, &runs)?;
    if !recorder::is_standard_output(&path) {
        say!("{}", path.display());
    }
    recorded::told(damages)
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
    let report = beside.exists().then(|| Report::read(&beside)).transpose().map_err(Failure::data)?;
    Ok(page_of(name, &recording, report))
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
pub struct RunReport {
    path: PathBuf,
    recording: PathBuf,
    /// Whether the recording is made for the page alone.
    is_temporary: bool,
}

impl RunReport {
    /// Checks that the page can be written. Without a `recording`, the run is recorded beside the page.
    pub fn new(path: &Path, recording: Option<&Path>) -> Result<Self, Failure> {
        check_place(path)?;
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

    /// Writes the page.
    pub fn write(&self, report: Report) -> Result<(), Failure> {
        let name = report.run.recording.clone().unwrap_or_default();
        let recording = Recording::open(&self.recording).map_err(Failure::data)?;
        let (run, damages) = page_of(name, &recording, Some(report));
        write(&self.path, &[run])?;
        recorded::told(damages).map(drop)
    }
}

impl Drop for RunReport {
    fn drop(&mut self) {
        if self.is_temporary {
            let _ = std::fs::remove_file(&self.recording);
        }
    }
}

fn write(path: &Path, runs: &[RunPage]) -> Result<(), Failure> {
    use std::io::Write as _;
    let failed = |error| Failure::file(path, error);
    let mut file = WholeFile::create(path).map_err(failed)?;
    file.write_all(view::html(runs).as_bytes()).and_then(|()| file.finish()).map_err(failed)
}
