//! Forecasts as the body of a frame: a [`TickHead`], and for each agent an [`AgentHead`], the single best path
//! and the most probable modes.
//!
//! A path has `horizon_len` pairs of 16-bit numbers. Each pair is the step (x, y) in cm from the previous
//! position; the first step starts at the agent's position. A mode is a probability, a 16-bit number of
//! which 65535 stands for 1, and a path. Sums of steps are exact, so rounding errors do not add up.

use bytemuck::{Pod, Zeroable, bytes_of};
use wire::{AGENTS_MAX, AgentType, Forecast, HORIZON_MAX, MODES_MAX, Quality, Rejected};

use super::{Bytes, Refused, TickHead, at_most};

/// Most modes of an agent.
pub const MODES_SENT_MAX: usize = 5;
/// Most bytes of a body.
pub const BODY_BYTES_MAX: usize = size_of::<TickHead>() + AGENTS_MAX * AGENT_BYTES_MAX;

const PATH_BYTES_MAX: usize = HORIZON_MAX * size_of::<[i16; 2]>();
const AGENT_BYTES_MAX: usize =
    size_of::<AgentHead>() + PATH_BYTES_MAX + MODES_SENT_MAX * (size_of::<u16>() + PATH_BYTES_MAX);
/// Units of a heading in a radian.
const HEADING_UNITS: f32 = 1e4;

/// An agent, without its paths.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct AgentHead {
    /// The track.
    pub id: u64,
    /// The detections' own identity, or 0.
    pub source_id: u64,
    /// Age of the forecast's inputs at the stamp, in µs; 0 for learned forecasts.
    pub age_us: u32,
    /// Position at the stamp, from the origin.
    pub x_cm: i32,
    /// Position at the stamp, from the origin.
    pub y_cm: i32,
    /// Bits of all causes that apply, see [`wire::Cause::bit`].
    pub causes: u32,
    /// Velocity at the stamp, cm/s.
    pub vx_cmps: i16,
    /// Velocity at the stamp, cm/s.
    pub vy_cmps: i16,
    /// Heading at the stamp, 1e-4 rad, counter-clockwise from +x.
    pub heading: i16,
    /// Extent along the heading; 0 if unknown.
    pub length_cm: u16,
    /// Extent across the heading; 0 if unknown.
    pub width_cm: u16,
    /// [`AgentType`] as a number.
    pub agent_type: u8,
    /// [`Quality`] as a number.
    pub quality: u8,
    /// [`wire::Cause`] as a number.
    pub cause: u8,
    /// Number of modes that follow, the most probable first.
    pub modes_len: u8,
    /// Zero.
    pub reserved: [u8; 2],
}

const _: () = assert!(size_of::<AgentHead>() == 48);

/// Positions in cm, from the origin.
pub type Path = Vec<[i32; 2]>;

/// An agent and its forecast.
#[derive(Clone, Debug, PartialEq)]
pub struct Agent {
    /// The agent at the stamp.
    pub head: AgentHead,
    /// The single best forecast.
    pub best: Path,
    /// Modes with their probabilities of 65535, the most probable first.
    pub modes: Vec<(u16, Path)>,
}

/// The forecasts of a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Forecasts {
    /// Stamp, steps and pose.
    pub head: TickHead,
    /// The agents.
    pub agents: Vec<Agent>,
}

/// Writes a body with at most `modes_max` modes of each agent. A forecast with a step of more than 327 m, or
/// with a number that is not finite, is left out and counted.
pub fn write(body: &mut Vec<u8>, head: &TickHead, forecasts: &[Forecast], modes_max: usize) {
    let mut head = *head;
    let horizon_len = usize::from(head.horizon_len);
    body.clear();
    body.extend_from_slice(bytes_of(&head));
    for forecast in forecasts {
        let start = body.len();
        if usize::from(head.elements_len) < AGENTS_MAX
            && write_agent(body, forecast, horizon_len, modes_max).is_some()
        {
            head.elements_len += 1;
        } else {
            body.truncate(start);
            head.left_out_len = head.left_out_len.saturating_add(1);
        }
    }
    body[..size_of::<TickHead>()].copy_from_slice(bytes_of(&head));
}

fn write_agent(body: &mut Vec<u8>, forecast: &Forecast, horizon_len: usize, modes_max: usize) -> Option<()> {
    let (modes, modes_len) = most_probable(forecast, modes_max);
    let (x_cm, y_cm) = (cm(forecast.x_m)?, cm(forecast.y_m)?);
    let head = AgentHead {
        id: forecast.id,
        source_id: forecast.source_id,
        age_us: u32::try_from(forecast.age_ns / 1_000).unwrap_or(u32::MAX),
        x_cm,
        y_cm,
        causes: forecast.causes,
        vx_cmps: i16::try_from(cm(forecast.vx_mps)?).ok()?,
        vy_cmps: i16::try_from(cm(forecast.vy_mps)?).ok()?,
        // In ±π, which a sum of turns may exceed.
        heading: (wrapped(forecast.heading_rad)? * HEADING_UNITS).round() as i16,
        length_cm: cm(forecast.length_m)?.clamp(0, u16::MAX.into()) as u16,
        width_cm: cm(forecast.width_m)?.clamp(0, u16::MAX.into()) as u16,
        agent_type: u8::try_from(forecast.agent_type).ok()?,
        quality: u8::try_from(forecast.quality).ok()?,
        cause: u8::try_from(forecast.cause).ok()?,
        modes_len: modes_len as u8,
        reserved: [0; 2],
    };
    body.extend_from_slice(bytes_of(&head));
    write_path(body, [x_cm, y_cm], &forecast.best[..horizon_len])?;
    for &mode in &modes[..modes_len] {
        let probability = (forecast.probability[mode].clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u16;
        body.extend_from_slice(&probability.to_le_bytes());
        write_path(body, [x_cm, y_cm], &forecast.modes[mode][..horizon_len])?;
    }
    Some(())
}

/// The places of the most probable modes, the most probable first. Among equals the order stays.
fn most_probable(forecast: &Forecast, modes_max: usize) -> ([usize; MODES_MAX], usize) {
    let known_len = (forecast.modes_len as usize).min(MODES_MAX);
    let mut places = std::array::from_fn(|place| place);
    let probability = |place: usize| forecast.probability[place];
    places[..known_len].sort_unstable_by(|&a, &b| probability(b).total_cmp(&probability(a)).then(a.cmp(&b)));
    (places, known_len.min(modes_max).min(MODES_SENT_MAX))
}

fn write_path(body: &mut Vec<u8>, start_cm: [i32; 2], path_m: &[[f32; 2]]) -> Option<()> {
    let mut previous = start_cm;
    for &[x_m, y_m] in path_m {
        let position = [cm(x_m)?, cm(y_m)?];
        for axis in [0, 1] {
            let step = i16::try_from(position[axis].checked_sub(previous[axis])?).ok()?;
            body.extend_from_slice(&step.to_le_bytes());
        }
        previous = position;
    }
    Some(())
}

/// Whole centimetres; `None` if the number is not finite or too large.
fn cm(m: f32) -> Option<i32> {
    let cm = (f64::from(m) * 100.0).round();
    (cm.abs() <= f64::from(i32::MAX)).then_some(cm as i32)
}

/// A heading in ±π; `None` if it is not finite.
fn wrapped(heading_rad: f32) -> Option<f32> {
    use std::f32::consts::{PI, TAU};
    let turned = (heading_rad + PI).rem_euclid(TAU) - PI;
    turned.is_finite().then_some(turned)
}

/// Reads a body.
///
/// # Errors
/// [`Refused`] names the first impossible value.
pub fn read(body: &[u8]) -> Result<Forecasts, Refused> {
    let mut bytes = Bytes(body);
    let head = bytes.head(AGENTS_MAX)?;
    at_most("horizon_len", head.horizon_len.into(), HORIZON_MAX)?;
    let mut agents = Vec::with_capacity(head.elements_len.into());
    for _ in 0..head.elements_len {
        agents.push(read_agent(&mut bytes, head.horizon_len.into())?);
    }
    bytes.end()?;
    Ok(Forecasts { head, agents })
}

fn read_agent(bytes: &mut Bytes<'_>, horizon_len: usize) -> Result<Agent, Refused> {
    let head: AgentHead = bytes.take()?;
    let unknown = |field, value: u8| Refused::Value(Rejected::Impossible { field, value: value.into() });
    AgentType::try_from(u32::from(head.agent_type)).map_err(|_| unknown("agent_type", head.agent_type))?;
    Quality::try_from(u32::from(head.quality))?;
    at_most("modes_len", head.modes_len.into(), MODES_SENT_MAX)?;
    let start = [head.x_cm, head.y_cm];
    let best = read_path(bytes, start, horizon_len)?;
    let mut modes = Vec::with_capacity(head.modes_len.into());
    for _ in 0..head.modes_len {
        modes.push((bytes.take()?, read_path(bytes, start, horizon_len)?));
    }
    Ok(Agent { head, best, modes })
}

fn read_path(bytes: &mut Bytes<'_>, mut position: [i32; 2], horizon_len: usize) -> Result<Path, Refused> {
    let mut path = Vec::with_capacity(horizon_len);
    for _ in 0..horizon_len {
        let step: [i16; 2] = bytes.take()?;
        for axis in [0, 1] {
            position[axis] = position[axis].saturating_add(step[axis].into());
        }
        path.push(position);
    }
    Ok(path)
}
