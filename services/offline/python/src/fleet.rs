//! What jobs over many recordings compute of one: `stgdat.fleet` distributes the calls and merges the results.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use console::failure::Failure;
use evaluator::fleet::{Learned, Outcome, OutcomeErrors, Outcomes, count_differences, differences as pairs};
use launch::arguments::Prepared;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use recording::Message;
use serde_json::json;
use wire::{Cause, ForecastsTopic, Quality, Topic};

use crate::error;
use crate::recording::{load, prepare, record_of};

/// Columns of a table, by name.
type Columns<'py> = PyResult<Bound<'py, PyDict>>;

/// The recording of these arguments, and the run that plays it.
fn prepared(arguments: Vec<String>) -> PyResult<(Prepared, data::Recording)> {
    let prepared = prepare(arguments)?;
    let recording = load(&prepared)?;
    Ok((prepared, recording))
}

fn failed(why: evaluator::EvaluateError) -> PyErr {
    error::of_failure(&Failure::data(why))
}

/// The outcomes of a recording with these arguments.
fn played(arguments: Vec<String>) -> PyResult<Outcomes> {
    let (Prepared { run, model, .. }, recording) = prepared(arguments)?;
    evaluator::fleet::outcomes(recording, &run, &model, None).map(|(outcomes, _)| outcomes).map_err(failed)
}

/// Checks arguments without a recording.
#[pyfunction]
pub fn check(py: Python<'_>, arguments: Vec<String>) -> PyResult<()> {
    py.detach(|| prepare(arguments).map(|_| ()))
}

/// Examines a recording, as `stgdat inspect --json` does. Returns JSON.
#[pyfunction]
pub fn inspect(py: Python<'_>, arguments: Vec<String>) -> PyResult<String> {
    py.detach(|| {
        let (_, recording) = prepared(arguments)?;
        let mut inspection = data::inspect(&recording);
        launch::tracking::add_noise(&mut inspection, recording);
        serde_json::to_string(&inspection).map_err(|why| error::of(&why))
    })
}

/// Every forecast of a recording beside what its agent then did: columns with a row for each agent and tick.
#[pyfunction]
pub fn outcomes(py: Python<'_>, arguments: Vec<String>) -> Columns<'_> {
    let rows = py.detach(|| played(arguments))?.rows;
    let columns = PyDict::new(py);
    let set = |name: &str, of: &dyn Fn(&Outcome) -> Option<f64>| {
        columns.set_item(name, rows.iter().map(of).collect::<Vec<Option<f64>>>())
    };
    let error = |of: &Outcome, value: fn(&OutcomeErrors) -> f64| of.errors.as_ref().map(value);
    set("x_m", &|of| Some(f64::from(of.position_m[0])))?;
    set("y_m", &|of| Some(f64::from(of.position_m[1])))?;
    set("speed_mps", &|of| Some(f64::from(of.speed_mps)))?;
    set("ade_m", &|of| error(of, |errors| errors.best.ade_m))?;
    set("fde_m", &|of| error(of, |errors| errors.best.fde_m))?;
    set("min_ade_m", &|of| error(of, |errors| errors.best_of.ade_m))?;
    set("min_fde_m", &|of| error(of, |errors| errors.best_of.fde_m))?;
    set("constant_velocity_ade_m", &|of| error(of, |errors| errors.steady.ade_m))?;
    set("constant_velocity_fde_m", &|of| error(of, |errors| errors.steady.fde_m))?;
    set("nll", &|of| error(of, |errors| errors.nll))?;
    set("contact_s", &|of| of.contact.map(|contact| f64::from(contact.after_s)))?;
    set("contact_mps2", &|of| of.contact.map(|contact| f64::from(contact.deceleration_mps2)))?;
    let name = |known: Option<&'static str>| known.unwrap_or("unknown");
    columns.set_item("seq", rows.iter().map(|of| of.seq).collect::<Vec<_>>())?;
    columns.set_item("stamp_ns", rows.iter().map(|of| of.stamp_ns).collect::<Vec<_>>())?;
    columns.set_item("track", rows.iter().map(|of| of.track).collect::<Vec<_>>())?;
    columns.set_item("agent", rows.iter().map(|of| of.agent).collect::<Vec<_>>())?;
    columns.set_item("type", rows.iter().map(|of| of.agent_type.name()).collect::<Vec<_>>())?;
    let quality = |of: &Outcome| name(Quality::ALL.get(of.quality as usize).map(|of| of.name()));
    let cause = |of: &Outcome| Cause::name_of(of.cause).into_owned();
    columns.set_item("quality", rows.iter().map(quality).collect::<Vec<_>>())?;
    columns.set_item("cause", rows.iter().map(cause).collect::<Vec<_>>())?;
    let with = rows.iter().map(|of| of.contact.map(|contact| contact.with));
    columns.set_item("contact_with", with.collect::<Vec<_>>())?;
    Ok(columns)
}

/// The forecasts of a recording by `before` and `after`, which are arguments of `stgdat predict`: counts by type of
/// agent as JSON, and columns with a row for each agent and tick that both have. For a record of a run, the recorded
/// forecasts stand for `before`.
#[pyfunction]
pub fn differences(
    py: Python<'_>,
    before: Vec<String>,
    after: Vec<String>,
) -> PyResult<(String, Bound<'_, PyDict>)> {
    let (found, [only_before, only_after]) = py.detach(|| {
        let prepared = prepare(before.clone())?;
        let before = match record_of(&prepared)? {
            None => played(before)?,
            Some(record) => recorded(&record, &load(&prepared)?)?,
        };
        Ok::<_, PyErr>(pairs(&before.rows, &played(after)?.rows))
    })?;
    let counts = json!({
        "types": count_differences(&found),
        "only_before": only_before,
        "only_after": only_after,
    });
    let columns = PyDict::new(py);
    columns.set_item("stamp_ns", found.iter().map(|of| of.stamp_ns).collect::<Vec<_>>())?;
    columns.set_item("agent", found.iter().map(|of| of.agent).collect::<Vec<_>>())?;
    columns.set_item("type", found.iter().map(|of| of.agent_type.name()).collect::<Vec<_>>())?;
    columns.set_item("apart_m", found.iter().map(|of| of.apart_m).collect::<Vec<_>>())?;
    for (side, name) in ["before", "after"].into_iter().enumerate() {
        let ade_m: Vec<_> = found.iter().map(|of| of.errors.map(|errors| errors[side].ade_m)).collect();
        let fde_m: Vec<_> = found.iter().map(|of| of.errors.map(|errors| errors[side].fde_m)).collect();
        columns.set_item(format!("{name}_ade_m"), ade_m)?;
        columns.set_item(format!("{name}_fde_m"), fde_m)?;
    }
    Ok((counts.to_string(), columns))
}

/// Writes `page.html` into a folder: the forecasts of a recording by `before` and `after`, as `stgdat report A B` draws
/// them. A record of a run stands for `before`. The folder also receives the forecasts.
#[pyfunction]
pub fn compare(py: Python<'_>, before: Vec<String>, after: Vec<String>, folder: PathBuf) -> PyResult<()> {
    py.detach(|| {
        let (second, page) = (folder.join("after.mcap"), folder.join("page.html"));
        let mut first = folder;
        first.push("before.mcap");
        let record = record_of(&prepare(before.clone())?)?;
        let first = record.map_or_else(|| record_played(before, first), |of| Ok(of.path().to_owned()))?;
        let files = [first, record_played(after, second)?];
        let written = launch::pages::write_page(&page, &files.each_ref().map(PathBuf::as_path));
        written.map(drop).map_err(|failure| error::of_failure(&failure))
    })
}

/// Records the forecasts of a recording with these arguments, and returns the path.
fn record_played(arguments: Vec<String>, path: PathBuf) -> PyResult<PathBuf> {
    let (Prepared { run, model, .. }, recording) = prepared(arguments)?;
    let recorded = launch::pages::record_played(recording, &run, &model, &path);
    recorded.map(|()| path).map_err(|failure| error::of_failure(&failure))
}

/// The forecasts of a record beside its detections.
fn recorded(record: &recording::Recording, detections: &data::Recording) -> PyResult<Outcomes> {
    let mut outcomes = Outcomes::of(detections);
    if !record.has_topic(ForecastsTopic::NAME) {
        let path = record.path().display();
        return Err(error::InputError::new_err(format!("{path}: the forecasts were not recorded")));
    }
    for message in record.messages() {
        let Ok(Message::Frame(frame)) = message else { continue };
        if frame.topic().name == ForecastsTopic::NAME && frame.header().is_tick() {
            let forecasts = frame.elements::<ForecastsTopic>().map_err(|why| error::of(&why))?;
            outcomes.add(frame.header(), &forecasts);
        }
    }
    Ok(outcomes)
}

/// What a recording shows the experts to be worth. Returns JSON, which [`priors`] merges.
#[pyfunction]
pub fn learn(py: Python<'_>, arguments: Vec<String>) -> PyResult<String> {
    py.detach(|| {
        let (Prepared { run, model, .. }, recording) = prepared(arguments)?;
        let learned = evaluator::fleet::learn(recording, &run, &model).map_err(failed)?;
        serde_json::to_string(&learned).map_err(|why| error::of(&why))
    })
}

/// The file for `--set sampler.prior=FILE`, from the results of [`learn`] with the names of their sources.
#[pyfunction]
pub fn priors(py: Python<'_>, learned: Vec<(String, String)>) -> PyResult<String> {
    py.detach(|| {
        let mut sources: BTreeMap<String, Vec<Learned>> = BTreeMap::new();
        for (source, text) in learned {
            let of_recording = serde_json::from_str(&text).map_err(|why| error::of(&why))?;
            sources.entry(source).or_default().push(of_recording);
        }
        Ok(evaluator::fleet::priors(&sources).to_json())
    })
}

/// The `count` worst ticks of a recording by each criterion, at least `apart_s` apart. Returns JSON.
#[pyfunction]
pub fn worst(py: Python<'_>, arguments: Vec<String>, count: usize, apart_s: f64) -> PyResult<String> {
    py.detach(|| {
        let outcomes = played(arguments)?;
        let apart_ns = (apart_s * 1e9) as u64;
        let ticks = evaluator::fleet::worst(&outcomes.rows, count, apart_ns).into_iter().map(|tick| {
            json!({
                "criterion": tick.criterion.name(),
                "value": tick.value,
                "seq": tick.seq,
                "stamp_ns": tick.stamp_ns,
                "agent": tick.agent,
                "other": tick.other,
                "position_m": tick.position_m,
            })
        });
        Ok(json!(ticks.collect::<Vec<_>>()).to_string())
    })
}

/// Writes the frames of a recording from `from_ns` up to `to_ns` as CSV, and returns their number.
#[pyfunction]
pub fn cut(
    py: Python<'_>,
    arguments: Vec<String>,
    from_ns: i64,
    to_ns: i64,
    file: PathBuf,
) -> PyResult<usize> {
    py.detach(|| {
        let (_, recording) = prepared(arguments)?;
        let inside = |frame: &&data::Frame| (from_ns..=to_ns).contains(&frame.stamp_ns);
        let frames: Vec<data::Frame> = recording.frames.iter().filter(inside).cloned().collect();
        if frames.is_empty() {
            return Err(PyValueError::new_err(format!(
                "{}: no frame from {from_ns} to {to_ns} ns",
                recording.name
            )));
        }
        let mut output = BufWriter::new(File::create(file)?);
        data::write_frames(&mut output, &frames)?;
        Ok(frames.len())
    })
}
