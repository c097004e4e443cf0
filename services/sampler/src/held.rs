use kinematics::{Moments, mixture};
use wire::{AGENTS_MAX, Forecast, HORIZON_MAX, MODES_MAX};

use crate::learned::Within;

/// The last learned forecast of each track, for as many tracks as a frame can have.
pub(crate) struct HeldForecasts {
    held: Vec<Held>,
}

/// A learned forecast that may be told again later.
#[derive(Clone, Copy)]
pub(crate) struct Held {
    stamp_ns: i64,
    forecast: Forecast,
    within: Within,
}

impl HeldForecasts {
    pub(crate) fn new() -> Self {
        Self { held: Vec::with_capacity(AGENTS_MAX) }
    }

    /// Keeps a learned forecast; in its place gives way an older one of the track, or for a new track the oldest of all.
    pub(crate) fn keep(&mut self, stamp_ns: i64, forecast: &Forecast, within: &Within) {
        let fresh = Held { stamp_ns, forecast: *forecast, within: *within };
        let known = self.held.iter().position(|held| held.forecast.id == forecast.id);
        if known.is_none() && self.held.len() < AGENTS_MAX {
            self.held.push(fresh);
            return;
        }
        let oldest = || (0..self.held.len()).min_by_key(|place| self.held[*place].stamp_ns).unwrap_or(0);
        let place = known.unwrap_or_else(oldest);
        if self.held[place].stamp_ns <= stamp_ns {
            self.held[place] = fresh;
        }
    }

    /// The forecast of a track and its age, if one of at most `max_age_ns` is kept.
    pub(crate) fn find(&self, id: u64, now_ns: i64, max_age_ns: u64) -> Option<(&Held, u64)> {
        let held = self.held.iter().find(|held| held.forecast.id == id)?;
        let age_ns = u64::try_from(now_ns.checked_sub(held.stamp_ns)?).ok()?;
        (age_ns <= max_age_ns).then_some((held, age_ns))
    }
}

impl Held {
    /// Writes the forecast as of `age_steps` later, where the agent is at the position that `out` tells.
    ///
    /// Each trajectory is taken from the point that it foresaw for now, moved so that this is where the agent is, and
    /// beyond its horizon goes on at its last velocity. The covariance within the modes is that foreseen for the time.
    pub(crate) fn tell(&self, age_steps: f32, horizon_len: usize, out: &mut Forecast) {
        let origin_m = [self.forecast.x_m, self.forecast.y_m];
        let now_m = [out.x_m, out.y_m];
        let moved = |trajectory: &[[f32; 2]; HORIZON_MAX], out: &mut [[f32; 2]; HORIZON_MAX]| {
            let knots = &trajectory[..horizon_len];
            let foreseen_m = at(origin_m, knots, age_steps);
            for (step, out) in out[..horizon_len].iter_mut().enumerate() {
                let there_m = at(origin_m, knots, age_steps + (step + 1) as f32);
                *out = [0, 1].map(|axis| now_m[axis] + (there_m[axis] - foreseen_m[axis]));
            }
        };
        let modes_len = (self.forecast.modes_len as usize).min(MODES_MAX);
        for (mode, out) in self.forecast.modes.iter().zip(&mut out.modes).take(modes_len) {
            moved(mode, out);
        }
        moved(&self.forecast.best, &mut out.best);
        out.modes_len = self.forecast.modes_len;
        out.probability = self.forecast.probability;
        (out.steering, out.frame_heading_rad) = (self.forecast.steering, self.forecast.frame_heading_rad);
        out.controls = self.forecast.controls;
        for step in 0..horizon_len {
            let covariance = self.within_at(age_steps + (step + 1) as f32, horizon_len);
            let parts = out.probability.iter().zip(&out.modes).take(modes_len);
            let mixed = mixture(parts.map(|(p, mode)| (*p, Moments { mean: mode[step], covariance })));
            (out.mean[step], out.covariance[step]) = (mixed.mean, mixed.covariance);
        }
    }

    /// The covariance within the modes; beyond the horizon it grows with the square of time, as a velocity's does.
    fn within_at(&self, steps: f32, horizon_len: usize) -> [f32; 3] {
        let growth = (steps / horizon_len as f32).max(1.0);
        let known = at([0.0; 3], &self.within[..horizon_len], steps.min(horizon_len as f32));
        known.map(|entry| entry * growth * growth)
    }
}

/// What a trajectory foresaw for `steps` after its origin, linear between steps and beyond the last.
fn at<const D: usize>(origin: [f32; D], knots: &[[f32; D]], steps: f32) -> [f32; D] {
    let knot = |step: usize| if step == 0 { origin } else { knots[step - 1] };
    let before = (steps.max(0.0) as usize).min(knots.len() - 1);
    let share = steps.max(0.0) - before as f32;
    let (from, to) = (knot(before), knot(before + 1));
    std::array::from_fn(|i| from[i] + (to[i] - from[i]) * share)
}
