//! Recordings.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use clap::Parser;
use console::failure::Failure;
use data::{GeneratedScene, SceneOptions};
use launch::arguments::{PlaybackArguments, Prepared};
use launch::tracking::add_noise;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use recording::{Message, ReadError};
use source::PlaybackOptions;
use wire::{Detection, DetectionsTopic, Topic as _, WorldOrigin, flags};

use crate::block::{Block, Owner};
use crate::error;
use crate::frame::Frame;

/// The command line of `stgdat predict`.
#[derive(Parser)]
#[command(name = "stgdat", no_binary_name = true)]
struct Line {
    #[command(flatten)]
    playback: PlaybackArguments,
}

/// Reads the arguments of `stgdat predict`.
pub fn parse(arguments: Vec<String>) -> PyResult<PlaybackArguments> {
    let line = Line::try_parse_from(arguments).map_err(|wrong| {
        let text = wrong.to_string();
        let first = text.lines().next().unwrap_or_default();
        error::InputError::new_err(first.strip_prefix("error: ").unwrap_or(first).to_owned())
    })?;
    Ok(line.playback)
}

/// Reads the arguments of `stgdat predict` and checks them.
pub fn prepare(arguments: Vec<String>) -> PyResult<Prepared> {
    parse(arguments)?.prepare().map_err(|failure| error::of_failure(&failure))
}

/// The record of a run that the arguments name; `None` for any other recording.
pub fn record_of(prepared: &Prepared) -> PyResult<Option<recording::Recording>> {
    prepared.source.recording.as_deref().map_or(Ok(None), record_at)
}

/// The record of a run at a path; `None` for any other recording.
pub fn record_at(path: &Path) -> PyResult<Option<recording::Recording>> {
    match recording::Recording::open(path) {
        Ok(record) => Ok(Some(record)),
        Err(ReadError::Foreign { .. } | ReadError::NotOurs { .. }) => Ok(None),
        Err(why) => Err(error::of(&why)),
    }
}

/// Reads the recording that the arguments name, or the detections of a record.
pub fn load(prepared: &Prepared) -> PyResult<data::Recording> {
    if let Some(record) = record_of(prepared)? {
        return detections_of(&record);
    }
    let Prepared { source, run, .. } = prepared;
    source::recording(source, run.origin(), run.seed).map_err(|why| error::of_failure(&Failure::from(why)))
}

/// Generates a complete scene, of the length that the arguments give.
fn complete(Prepared { source, run, .. }: &Prepared) -> PyResult<data::Recording> {
    let options = SceneOptions { seed: run.seed, ..SceneOptions::complete(source.agents) };
    let scene = GeneratedScene::new(options).map_err(|why| error::of(&why))?;
    Ok(scene.recording(source.ticks.unwrap_or_default() as usize))
}

/// The detections of a record, as the sensor sent them.
pub fn detections_of(record: &recording::Recording) -> PyResult<data::Recording> {
    let (name, sha256) = data::identity(record.path()).map_err(|why| error::of(&why))?;
    let mut frames: BTreeMap<i64, data::Frame> = BTreeMap::new();
    let mut has_identities = true;
    for message in record.messages() {
        let Ok(Message::Frame(frame)) = message else { continue };
        let header = frame.header();
        if frame.topic().name != DetectionsTopic::NAME || !header.is_tick() {
            continue;
        }
        has_identities &= header.has(flags::HAS_IDENTITIES);
        let ego = data::Ego {
            position_m: header.ego_m,
            heading_rad: header.ego_heading_rad,
            is_sensor: header.has(flags::SEEN_FROM_EGO),
        };
        let detections = frame.elements::<DetectionsTopic>().map_err(|why| error::of(&why))?;
        let observed_types = header.observed_types;
        let sweep =
            data::Frame { stamp_ns: header.stamp_ns, observed_types, ego, detections, ..Default::default() };
        frames.insert(header.stamp_ns, sweep);
    }
    if frames.is_empty() {
        let path = record.path().display();
        return Err(error::InputError::new_err(format!("{path}: no detections were recorded")));
    }
    Ok(data::Recording {
        name,
        sha256,
        interval_ns: record.about().run.interval_ns,
        has_identities,
        frames: frames.into_values().collect(),
        own_stamps: true,
        ..data::Recording::default()
    })
}

/// A recording: frames of detections in time order.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Recording {
    pub recording: data::Recording,
    pub origin: WorldOrigin,
    path: Option<String>,
    detections: Arc<[Detection]>,
    stamps_ns: Arc<[i64]>,
    offsets: Arc<[i64]>,
}

/// Opens the recording of these arguments of `stgdat predict`; a generated scene if they name none. The agents
/// of a complete scene are all detected, with their identities.
#[pyfunction]
pub fn open(py: Python<'_>, arguments: Vec<String>, is_complete: bool) -> PyResult<Recording> {
    py.detach(|| {
        let prepared = prepare(arguments)?;
        let recording = if is_complete { complete(&prepared)? } else { load(&prepared)? };
        let Prepared { source, run, .. } = prepared;
        let path = source.recording.map(|path| path.display().to_string());
        Ok(Recording::new(recording, path, run.origin()))
    })
}

#[pymethods]
impl Recording {
    #[getter]
    fn name(&self) -> &str {
        &self.recording.name
    }

    #[getter]
    fn path(&self) -> Option<&str> {
        self.path.as_deref()
    }

    #[getter]
    fn sha256(&self) -> &str {
        &self.recording.sha256
    }

    #[getter]
    const fn interval_ns(&self) -> u64 {
        self.recording.interval_ns
    }

    #[getter]
    const fn has_identities(&self) -> bool {
        self.recording.has_identities
    }

    #[getter]
    const fn origin_m(&self) -> (f64, f64) {
        let [x_m, y_m] = self.origin.position_m();
        (x_m, y_m)
    }

    /// What the audit of the recording doubts, with the changes of its noise, which a tracker learns.
    fn doubts(&self, py: Python<'_>) -> Vec<String> {
        py.detach(|| self.found())
    }

    fn detections(&self) -> Block {
        Block::new(Owner::Detections(self.detections.clone()))
    }

    fn stamps_ns(&self) -> Block {
        Block::new(Owner::Numbers(self.stamps_ns.clone()))
    }

    fn offsets(&self) -> Block {
        Block::new(Owner::Numbers(self.offsets.clone()))
    }

    /// The recording as a file in the project's own format. Its positions are in the world frame.
    fn csv<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let text = py.detach(|| {
            let mut text = Vec::new();
            data::write_frames(&mut text, &self.recording.frames).map(|()| text)
        })?;
        Ok(PyBytes::new(py, &text))
    }

    /// Plays the recording tick by tick, as `stgdat predict` does.
    fn play(&self, py: Python<'_>, ticks: Option<u64>) -> Playback {
        let options = PlaybackOptions { run_id: 0, ticks_max: ticks, lockstep: true };
        let playback = py.detach(|| source::Playback::new(self.recording.clone(), options));
        Playback { origin: self.origin, playback: Mutex::new(playback) }
    }
}

impl Recording {
    /// A recording with its columns for numpy.
    pub fn new(recording: data::Recording, path: Option<String>, origin: WorldOrigin) -> Self {
        let frames = || recording.frames.iter();
        let mut end = 0;
        let ends = frames().map(|frame| {
            end += frame.detections.len() as i64;
            end
        });
        Self {
            offsets: std::iter::once(0).chain(ends).collect(),
            detections: frames().flat_map(|frame| &frame.detections).copied().collect(),
            stamps_ns: frames().map(|frame| frame.stamp_ns).collect(),
            path,
            origin,
            recording,
        }
    }

    fn found(&self) -> Vec<String> {
        let mut inspection = data::inspect(&self.recording);
        if !self.recording.sha256.is_empty() {
            add_noise(&mut inspection, self.recording.clone());
        }
        inspection.findings.iter().filter(|found| found.doubtful).map(ToString::to_string).collect()
    }
}

/// The recording before and after a share of its time.
#[pyfunction]
pub fn split(py: Python<'_>, recording: &Bound<'_, Recording>, share: f64) -> (Recording, Recording) {
    let whole = recording.get();
    py.detach(|| {
        let [earlier, later] = trainer::split_in_time(whole.recording.clone(), share);
        let part = |recording| Recording::new(recording, whole.path.clone(), whole.origin);
        (part(earlier), part(later))
    })
}

/// The ticks of a recording.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Playback {
    origin: WorldOrigin,
    playback: Mutex<source::Playback>,
}

#[pymethods]
impl Playback {
    fn __len__(&self) -> usize {
        usize::try_from(self.lock().tick_count()).unwrap_or(usize::MAX)
    }

    const fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self) -> Option<Frame> {
        let mut playback = self.lock();
        let tick = playback.next_tick()?;
        let frame = recording::Frame::of::<DetectionsTopic>(&tick.header, tick.detections, 0);
        Some(Frame::new(frame, self.origin))
    }
}

impl Playback {
    fn lock(&self) -> std::sync::MutexGuard<'_, source::Playback> {
        self.playback.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
