//! Parts of a published forecast.

use wire::{Cause, Forecast, POSITION_MAX_M, Quality, Track, finite};

/// Begins a forecast with what it contains of its track; all else is 0.
pub(crate) fn begin(track: &Track, quality: Quality, cause: Cause, out: &mut Forecast) {
    // In place: as a value it would be written twice.
    bytemuck::write_zeroes(out);
    (out.id, out.source_id, out.agent_type) = (track.id, track.source_id, track.agent_type);
    (out.quality, out.cause, out.causes) = (quality as u32, cause as u32, cause.bit());
    (out.x_m, out.y_m, out.heading_rad) = (track.x_m, track.y_m, track.heading_rad);
    (out.vx_mps, out.vy_mps) = (track.vx_mps, track.vy_mps);
    (out.length_m, out.width_m) = (track.length_m, track.width_m);
    (out.prior, out.prior_age_ns) = (track.prior, track.prior_age_ns);
}

/// Whether all numbers of a forecast are possible.
pub(crate) fn is_within_the_world(forecast: &Forecast) -> bool {
    // Without an early end, so that it vectorises.
    let inside = |points: &[[f32; 2]]| {
        points.as_flattened().iter().fold(true, |inside, x| inside & (x.abs() <= POSITION_MAX_M))
    };
    let is_finite = |values: &[[f32; 3]]| finite("covariance", values.as_flattened()).is_ok();
    inside(forecast.modes.as_flattened())
        && inside(&forecast.best)
        && is_finite(&forecast.covariance)
        && is_finite(forecast.mode_covariance.as_flattened())
}
