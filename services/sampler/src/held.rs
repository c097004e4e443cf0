use kinematics::{Moments, mixture};
use wire::{AGENTS_MAX, Forecast, HORIZON_MAX, MODES_MAX};

/// The last learned forecast of each track, for the maximum number of tracks in a frame.
pub(crate) struct HeldForecasts {
    /// Track and stamp of each forecast. They are separate from the forecasts, so that a search reads only
    /// these few bytes.
    keys: Vec<Key>,
    forecasts: Vec<Forecast>,
}

/// Track and time of a forecast.
#[derive(Clone, Copy)]
struct Key {
    id: u64,
    stamp_ns: i64,
}

/// A learned forecast that may be published again later.
pub(crate) struct Held<'a>(&'a Forecast);

impl HeldForecasts {
    pub(crate) fn new() -> Self {
        Self { keys: Vec::with_capacity(AGENTS_MAX), forecasts: Vec::with_capacity(AGENTS_MAX) }
    }

    /// Drops all forecasts.
    pub(crate) fn clear(&mut self) {
        self.keys.clear();
        self.forecasts.clear();
    }

    /// Keeps a learned forecast. It replaces the track's previous one or, if the track is new and all places
    /// are taken, the oldest one. A newer forecast is never replaced.
    pub(crate) fn keep(&mut self, stamp_ns: i64, forecast: &Forecast) {
        let key = Key { id: forecast.id, stamp_ns };
        let known = self.keys.iter().position(|held| held.id == key.id);
        if known.is_none() && self.keys.len() < AGENTS_MAX {
            self.keys.push(key);
            self.forecasts.push(*forecast);
            return;
        }
        let oldest = || (0..self.keys.len()).min_by_key(|place| self.keys[*place].stamp_ns).unwrap_or(0);
        let place = known.unwrap_or_else(oldest);
        if self.keys[place].stamp_ns <= stamp_ns {
            self.keys[place] = key;
            self.forecasts[place] = *forecast;
        }
    }

    /// The last learned forecast of a track and its age, if one is kept.
    pub(crate) fn find(&self, id: u64, now_ns: i64) -> Option<(Held<'_>, u64)> {
        let place = self.keys.iter().position(|held| held.id == id)?;
        let age_ns = u64::try_from(now_ns.checked_sub(self.keys[place].stamp_ns)?).ok()?;
        Some((Held(&self.forecasts[place]), age_ns))
    }
}

impl Held<'_> {
    /// Writes the forecast, moved `age_steps` into the future, for an agent at the position in `out`.
    ///
    /// Each trajectory is cut at its prediction for the present time and shifted so that this point equals
    /// the agent's position. Beyond its horizon it continues at its last velocity. The modes keep the
    /// covariances predicted for each time. Beyond the horizon the covariances grow with the square of time,
    /// as the covariance of a velocity error does.
    pub(crate) fn move_on(&self, age_steps: f32, horizon_len: usize, out: &mut Forecast) {
        let Self(held) = self;
        let modes_len = (held.modes_len as usize).min(MODES_MAX);
        out.modes_len = held.modes_len;
        (out.probability, out.mode_expert) = (held.probability, held.mode_expert);
        (out.steering, out.frame_heading_rad) = (held.steering, held.frame_heading_rad);
        out.controls = held.controls;

        let origin_m = [held.x_m, held.y_m];
        let now_m = [out.x_m, out.y_m];
        let now = Between::knots(age_steps, horizon_len);
        let mut steps = [Later::default(); HORIZON_MAX];
        for (step, later) in steps[..horizon_len].iter_mut().enumerate() {
            *later = Later::of(age_steps + (step + 1) as f32, horizon_len);
        }
        let steps = &steps[..horizon_len];
        let moved = |trajectory: &[[f32; 2]; HORIZON_MAX], out: &mut [[f32; 2]; HORIZON_MAX]| {
            let predicted_m = now.of(origin_m, trajectory);
            for (later, out) in steps.iter().zip(out) {
                let there_m = later.position.of(origin_m, trajectory);
                *out = [0, 1].map(|axis| now_m[axis] + (there_m[axis] - predicted_m[axis]));
            }
        };
        let modes = held.modes.iter().zip(&held.mode_covariance).take(modes_len);
        let modes_out = out.modes.iter_mut().zip(&mut out.mode_covariance);
        for ((mode, covariance), (mode_out, covariance_out)) in modes.zip(modes_out) {
            moved(mode, mode_out);
            for (later, out) in steps.iter().zip(covariance_out) {
                *out = later.covariance(covariance);
            }
        }
        moved(&held.best, &mut out.best);

        let within = within_modes(held, modes_len, horizon_len);
        for (step, later) in steps.iter().enumerate() {
            let covariance = later.covariance(&within);
            let parts = out.probability.iter().zip(&out.modes).take(modes_len);
            let mixed = mixture(parts.map(|(p, mode)| (*p, Moments { mean: mode[step], covariance })));
            (out.mean[step], out.covariance[step]) = (mixed.mean, mixed.covariance);
        }
    }
}

/// The covariance of each step within the modes: the mixture's without the spread of its means.
fn within_modes(forecast: &Forecast, modes_len: usize, horizon_len: usize) -> [[f32; 3]; HORIZON_MAX] {
    let mut within = [[0.0; 3]; HORIZON_MAX];
    for (weight, covariance) in forecast.probability.iter().zip(&forecast.mode_covariance).take(modes_len) {
        for (sum, own) in within[..horizon_len].iter_mut().zip(covariance) {
            for (sum, own) in sum.iter_mut().zip(own) {
                *sum += weight * own;
            }
        }
    }
    within
}

/// A time at which a held forecast is evaluated, the same for all of its modes.
#[derive(Clone, Copy, Default)]
struct Later {
    position: Between,
    /// Within the horizon.
    covariance: Between,
    /// Factor by which standard deviations have grown since the horizon.
    growth: f32,
}

impl Later {
    /// The time `steps` after the forecast's stamp.
    fn of(steps: f32, horizon_len: usize) -> Self {
        let horizon = horizon_len as f32;
        Self {
            position: Between::knots(steps, horizon_len),
            covariance: Between::knots(steps.min(horizon), horizon_len),
            growth: (steps / horizon).max(1.0),
        }
    }

    fn covariance(&self, knots: &[[f32; 3]; HORIZON_MAX]) -> [f32; 3] {
        self.covariance.of([0.0; 3], knots).map(|entry| entry * self.growth * self.growth)
    }
}

/// A point of a trajectory, which is linear between its steps and beyond the last one.
#[derive(Clone, Copy, Default)]
struct Between {
    /// Number of steps before the point; 0 at the origin.
    before: usize,
    /// Share of the way to the next step.
    share: f32,
}

impl Between {
    /// The point `steps` after the origin of a trajectory of `len` steps.
    fn knots(steps: f32, len: usize) -> Self {
        let before = (steps.max(0.0) as usize).min(len - 1);
        Self { before, share: steps.max(0.0) - before as f32 }
    }

    /// The value of a trajectory at the point.
    fn of<const D: usize>(&self, origin: [f32; D], knots: &[[f32; D]; HORIZON_MAX]) -> [f32; D] {
        let from = if self.before == 0 { origin } else { knots[self.before - 1] };
        let to = knots[self.before];
        std::array::from_fn(|i| from[i] + (to[i] - from[i]) * self.share)
    }
}
