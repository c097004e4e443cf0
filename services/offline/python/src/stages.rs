//! The compute stages in this process.

use std::sync::{Mutex, MutexGuard, PoisonError};

use console::failure::Failure;
use launch::arguments::Prepared;
use launch::tracking::Tracking;
use onboard::Chain;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use wire::{
    ControlsTopic, Detection, DetectionsTopic, FeaturesTopic, ForecastsTopic, Header, Rejected, TracksTopic,
    WorldOrigin,
};

use crate::error::{self, InputError};
use crate::frame::Frame;
use crate::recording::{Recording, prepare};

/// Stages at a tick of their run.
struct Started<S> {
    prepared: Prepared,
    stages: S,
    /// Number of the next tick that has none.
    seq: u64,
}

impl<S> Started<S> {
    /// Takes the origin of detections that have one.
    fn adopt(&mut self, origin: WorldOrigin) -> PyResult<()> {
        let own = self.prepared.run.origin();
        if origin.is_zero() || origin == own {
            return Ok(());
        }
        if self.seq > 0 || !own.is_zero() {
            return Err(InputError::new_err(format!("origin = {origin}: the stages have the origin {own}")));
        }
        self.prepared.run.origin_m = origin.position_m();
        Ok(())
    }
}

/// Stages that Python's threads share.
struct Shared<S> {
    started: Mutex<Started<S>>,
    /// The process of the stages' worker threads. A fork has no copies of them.
    process: u32,
}

impl<S: Send> Shared<S> {
    fn new(
        py: Python<'_>,
        arguments: Vec<String>,
        start: fn(&Prepared) -> Result<S, Failure>,
    ) -> PyResult<Self> {
        py.detach(|| {
            let prepared = prepare(arguments)?;
            let stages = start(&prepared).map_err(|failure| error::of_failure(&failure))?;
            Ok(Self {
                started: Mutex::new(Started { prepared, stages, seq: 0 }),
                process: std::process::id(),
            })
        })
    }

    /// Begins a run. A recording gives it interval and origin.
    fn begin(
        &self,
        py: Python<'_>,
        recording: Option<&Recording>,
        start: fn(&Prepared) -> Result<S, Failure>,
    ) -> PyResult<()> {
        let played = recording.map(|of| (of.recording.interval_ns, of.origin));
        py.detach(|| {
            let mut started = self.lock()?;
            if let Some((interval_ns, origin)) = played {
                started.prepared.run.interval_ns = interval_ns;
                started.prepared.run.origin_m = origin.position_m();
            }
            started.stages = start(&started.prepared).map_err(|failure| error::of_failure(&failure))?;
            started.seq = 0;
            Ok(())
        })
    }

    /// Takes a tick through the stages.
    fn step(
        &self,
        py: Python<'_>,
        detections: &Frame,
        tick: impl FnOnce(&mut S, &Header, &[Detection]) -> Result<recording::Frame, Rejected> + Send,
    ) -> PyResult<Frame> {
        let elements = detections.frame.elements::<DetectionsTopic>().map_err(|why| error::of(&why))?;
        let mut header = *detections.frame.header();
        crate::frame::check(&header, &elements)?;
        py.detach(|| {
            let mut started = self.lock()?;
            started.adopt(detections.origin)?;
            if !detections.is_numbered {
                header.seq = started.seq;
            }
            started.seq = header.seq + 1;
            let frame =
                tick(&mut started.stages, &header, &elements).map_err(|why| refused(&header, &why))?;
            let own = WorldOrigin::new(started.prepared.run.origin_m).unwrap_or_default();
            Ok(Frame::new(frame, own))
        })
    }

    /// The stages, in the process that has made them.
    fn lock(&self) -> PyResult<MutexGuard<'_, Started<S>>> {
        if self.process != std::process::id() {
            return Err(PyRuntimeError::new_err(format!(
                "these stages belong to process {}: after a fork, make new ones, or start processes with \"spawn\"",
                self.process
            )));
        }
        Ok(self.started.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The exception of a tick that the tracker has refused.
fn refused(header: &Header, why: &Rejected) -> PyErr {
    InputError::new_err(format!("tick {} at {:.3} s: {why}", header.seq, header.stamp_ns as f64 / 1e9))
}

fn chain(prepared: &Prepared) -> Result<Chain, Failure> {
    Ok(Chain::new(&prepared.run, &prepared.model)?)
}

fn tracking(prepared: &Prepared) -> Result<Tracking, Failure> {
    Tracking::new(&prepared.run, &prepared.model)
}

/// All stages, from detections to forecasts.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Predictor(Shared<Chain>);

#[pymethods]
impl Predictor {
    #[new]
    fn new(py: Python<'_>, arguments: Vec<String>) -> PyResult<Self> {
        Shared::new(py, arguments, chain).map(Self)
    }

    fn begin(&self, py: Python<'_>, recording: Option<&Recording>) -> PyResult<()> {
        self.0.begin(py, recording, chain)
    }

    fn step(&self, py: Python<'_>, detections: &Frame) -> PyResult<Frame> {
        self.0.step(py, detections, |chain, header, detections| {
            let (header, forecasts) = chain.tick(header, detections, |_| ());
            let frame = recording::Frame::of::<ForecastsTopic>(&header, forecasts, 0);
            chain.refusal().map_or(Ok(frame), |why| Err(why.clone()))
        })
    }

    /// The tracks of the last tick.
    fn tracks(&self) -> PyResult<Frame> {
        let started = self.0.lock()?;
        let (tracks, _) = started.stages.frames();
        let frame = recording::Frame::of::<TracksTopic>(&tracks.header, &tracks.elements, 0);
        Ok(Frame::new(frame, started.prepared.run.origin()))
    }

    /// What entered the attention and what left the decoder, of the last tick.
    fn network(&self) -> PyResult<(Frame, Frame)> {
        let started = self.0.lock()?;
        let (features, controls) = started.stages.network();
        let origin = started.prepared.run.origin();
        let features = recording::Frame::of::<FeaturesTopic>(&features.header, &features.elements, 0);
        let controls = recording::Frame::of::<ControlsTopic>(&controls.header, &controls.elements, 0);
        Ok((Frame::new(features, origin), Frame::new(controls, origin)))
    }

    /// Writes the retrieval memory to its file.
    fn save_memory(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            let mut started = self.0.lock()?;
            let Started { stages, prepared, .. } = &mut *started;
            let kept = stages.end(&prepared.run);
            kept.map_err(|why| error::of_failure(&Failure::from(why)))
        })
    }
}

/// The tracker, with the stages that its prior needs.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Tracker(Shared<Tracking>);

#[pymethods]
impl Tracker {
    #[new]
    fn new(py: Python<'_>, arguments: Vec<String>) -> PyResult<Self> {
        Shared::new(py, arguments, tracking).map(Self)
    }

    fn begin(&self, py: Python<'_>, recording: Option<&Recording>) -> PyResult<()> {
        self.0.begin(py, recording, tracking)
    }

    fn step(&self, py: Python<'_>, detections: &Frame) -> PyResult<Frame> {
        self.0.step(py, detections, |tracking, header, detections| {
            let (header, tracks) = tracking.tick(header, detections);
            let frame = recording::Frame::of::<TracksTopic>(&header, tracks, 0);
            tracking.refusal().map_or(Ok(frame), |why| Err(why.clone()))
        })
    }
}
