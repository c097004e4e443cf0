//! Parts of a published forecast.

use wire::{Cause, Forecast, MODES_MAX, POSITION_MAX_M, Quality, Track, finite};

/// Begins a forecast with the fields that come from its track. All other fields are 0.
pub(crate) fn begin(track: &Track, quality: Quality, cause: Cause, out: &mut Forecast) {
    out.begin(track);
    (out.quality, out.cause, out.causes) = (quality as u32, cause as u32, cause.bit());
}

/// Limits each step of a forecast to `most_m`, the longest step that is possible for its type of agent.
pub(crate) fn limit_steps(out: &mut Forecast, horizon_len: usize, most_m: f32) {
    let (from_m, modes_len) = ([out.x_m, out.y_m], (out.modes_len as usize).min(MODES_MAX));
    let modes = out.modes[..modes_len].iter_mut();
    for path in modes.chain([&mut out.best, &mut out.mean]) {
        limit_path(from_m, &mut path[..horizon_len], most_m);
    }
}

fn limit_path(from_m: [f32; 2], path: &mut [[f32; 2]], most_m: f32) {
    let length_m = |from: [f32; 2], to: [f32; 2]| (to[0] - from[0]).hypot(to[1] - from[1]);
    let mut before_m = from_m;
    let is_within = path.iter().all(|&to| length_m(std::mem::replace(&mut before_m, to), to) <= most_m);
    if is_within {
        return;
    }
    let (mut before_m, mut limited_m) = (from_m, from_m);
    for to in path {
        let share = (most_m / length_m(before_m, *to).max(f32::MIN_POSITIVE)).min(1.0);
        for (axis, limited) in limited_m.iter_mut().enumerate() {
            *limited += share * (to[axis] - before_m[axis]);
        }
        before_m = std::mem::replace(to, limited_m);
    }
}

/// Whether all positions of a forecast are inside the world and all its covariances are finite.
pub(crate) fn is_within_the_world(forecast: &Forecast) -> bool {
    // No early exit, so that the loop vectorises.
    let inside = |points: &[[f32; 2]]| {
        points.as_flattened().iter().fold(true, |inside, x| inside & (x.abs() <= POSITION_MAX_M))
    };
    let is_finite = |values: &[[f32; 3]]| finite("covariance", values.as_flattened()).is_ok();
    inside(forecast.modes.as_flattened())
        && inside(&forecast.best)
        && is_finite(&forecast.covariance)
        && is_finite(forecast.mode_covariance.as_flattened())
}
