//! Frames of topics.

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use wire::{
    AGENT_TYPES, Counts, DETECTIONS_MAX, Detection, DetectionsTopic, ForecastsTopic, Header, Rejected, Topic,
    WorldOrigin, flags,
};

use crate::block::{Block, Owner};
use crate::error;

/// Header and elements of one topic at one tick.
#[pyclass(frozen, module = "stgdat._stgdat")]
pub struct Frame {
    pub frame: recording::Frame,
    pub origin: WorldOrigin,
    /// Whether the tick has a number. Otherwise the stages number it.
    pub is_numbered: bool,
}

impl Frame {
    /// A frame of a numbered tick.
    pub const fn new(frame: recording::Frame, origin: WorldOrigin) -> Self {
        Self { frame, origin, is_numbered: true }
    }
}

#[pymethods]
impl Frame {
    #[getter]
    fn topic(&self) -> &'static str {
        self.frame.topic().name
    }

    #[getter]
    fn element_bytes(&self) -> usize {
        self.frame.element_bytes()
    }

    #[getter]
    const fn received_ns(&self) -> u64 {
        self.frame.received_ns()
    }

    #[getter]
    const fn origin_m(&self) -> (f64, f64) {
        let [x_m, y_m] = self.origin.position_m();
        (x_m, y_m)
    }

    #[getter]
    fn is_tick(&self) -> bool {
        self.frame.header().is_tick()
    }

    #[getter]
    fn is_end(&self) -> bool {
        self.frame.header().has(flags::END)
    }

    fn header(&self) -> Block {
        Block::new(Owner::Header(self.frame.clone()))
    }

    fn elements(&self) -> Block {
        Block::new(Owner::Elements(self.frame.clone()))
    }

    /// The parts of which `frame` makes the same frame.
    fn parts<'py>(&self, py: Python<'py>) -> (String, usize, Bound<'py, PyBytes>, u64, (f64, f64), bool) {
        let Self { frame, is_numbered, .. } = self;
        let bytes = PyBytes::new(py, frame.bytes());
        let topic = frame.topic().name.to_owned();
        (topic, frame.element_bytes(), bytes, frame.received_ns(), self.origin_m(), *is_numbered)
    }

    /// The line that `stgdat predict` prints for these forecasts.
    fn json<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let forecasts = self.frame.elements::<ForecastsTopic>().map_err(|why| error::of(&why))?;
        let mut line = Vec::new();
        recorder::write_forecast_line(&mut line, self.frame.header(), &forecasts, self.origin)?;
        Ok(PyBytes::new(py, &line))
    }
}

/// The frame of these parts.
#[pyfunction]
pub fn frame(
    topic: &str,
    element_bytes: usize,
    bytes: &[u8],
    received_ns: u64,
    origin_m: (f64, f64),
    is_numbered: bool,
) -> PyResult<Frame> {
    let refused = |why: String| error::InputError::new_err(format!("a pickled frame of {topic}: {why}"));
    let number = recording::topic_number(topic).ok_or_else(|| refused("no such topic".to_owned()))?;
    let frame = recording::Frame::read_leading(number, element_bytes, bytes.into(), received_ns)
        .map_err(|why| refused(why.to_string()))?;
    let origin =
        WorldOrigin::new([origin_m.0, origin_m.1]).ok_or_else(|| refused("its origin".to_owned()))?;
    Ok(Frame { frame, origin, is_numbered })
}

/// The doubts of these bits, in sentences.
#[pyfunction]
pub fn doubts_of(bits: u32) -> Vec<String> {
    audit::Doubt::of_bits(bits).map(|doubt| audit::Found::of_kind(doubt).sentence).collect()
}

/// A frame of detections, whose header is that of a recording with the same content.
#[pyfunction]
pub fn detections(
    elements: &[u8],
    stamp_ns: i64,
    interval_ns: u64,
    has_identities: bool,
    ego: (f32, f32, f32),
    is_sensor: bool,
    seq: Option<u64>,
    origin: (f64, f64),
) -> PyResult<Frame> {
    let origin = WorldOrigin::new([origin.0, origin.1])
        .ok_or_else(|| error::InputError::new_err(format!("origin = {origin:?}: not finite, or too far")))?;
    let rows = elements.chunks_exact(size_of::<Detection>());
    let elements: Vec<Detection> = rows.map(bytemuck::pod_read_unaligned).collect();
    let all_types = AGENT_TYPES.iter().fold(0, |bits, agent_type| bits | agent_type.bit());
    let flag = |is_set: bool, flag: u32| if is_set { flag } else { 0 };
    let header = Header {
        flags: flags::LOCKSTEP
            | flag(has_identities, flags::HAS_IDENTITIES)
            | flag(is_sensor, flags::SEEN_FROM_EGO),
        interval_ns,
        observed_types: all_types,
        ego_m: [ego.0, ego.1],
        ego_heading_rad: ego.2,
        counts: Counts { agents_len: elements.len() as u32, ..Counts::default() },
        ..Header::new(0, seq.unwrap_or(0), stamp_ns)
    };
    check(&header, &elements)?;
    let frame = recording::Frame::of::<DetectionsTopic>(&header, &elements, 0);
    Ok(Frame { frame, origin, is_numbered: seq.is_some() })
}

/// Refuses detections that the tracker would refuse, and names the first wrong one.
pub fn check(header: &Header, detections: &[Detection]) -> PyResult<()> {
    let refused = |about: &str, why: Rejected| {
        crate::error::InputError::new_err(format!("{}{about}: {why}", DetectionsTopic::NAME))
    };
    wire::at_most("detections", detections.len(), DETECTIONS_MAX)
        .and_then(|()| header.check())
        .map_err(|why| refused("", why))?;
    let wrong = detections.iter().enumerate().find_map(|(row, of)| of.check().err().map(|why| (row, why)));
    wrong.map_or(Ok(()), |(row, why)| Err(refused(&format!("[{row}]"), why)))
}
