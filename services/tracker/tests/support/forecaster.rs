//! Forecasts with given controls, in place of the stages after the tracker.

use bytemuck::Zeroable;
use wire::{ControlGaussian, Counts, Forecast, Header, Quality, Steering, Track};

pub const STEP_NS: u64 = 400_000_000;
pub const HORIZON_LEN: usize = 12;

/// The controls of a mode, step by step.
pub type Controls = [[f64; 2]; HORIZON_LEN];

/// The header of forecasts for this number of agents.
pub fn forecasts_header(stamp_ns: i64, agents_len: usize) -> Header {
    let counts =
        Counts { agents_len: agents_len as u32, horizon_len: HORIZON_LEN as u32, ..Counts::default() };
    Header { step_ns: STEP_NS, counts, ..Header::new(1, 0, stamp_ns) }
}

/// A learned forecast of a track, with modes of given probability.
pub fn forecast(track: &Track, steering: Steering, modes: &[(f32, Controls)]) -> Forecast {
    let mut forecast = Forecast {
        id: track.id,
        agent_type: track.agent_type,
        quality: Quality::Learned as u32,
        modes_len: modes.len() as u32,
        x_m: track.x_m,
        y_m: track.y_m,
        heading_rad: track.heading_rad,
        steering: steering as u32,
        frame_heading_rad: track.heading_rad,
        ..Forecast::zeroed()
    };
    for (mode, (probability, controls)) in modes.iter().enumerate() {
        forecast.probability[mode] = *probability;
        for (written, control) in forecast.controls[mode].iter_mut().zip(controls) {
            *written = ControlGaussian { mean: control.map(|u| u as f32), cholesky: [0.1, 0.0, 0.02] };
        }
    }
    forecast
}
