//! Three motions of an agent: a *free* one, which follows every manoeuvre, a *steady* one, which averages
//! noise over seconds, and *standing*.
//!
//! The free motion is the [belief](crate::belief) with the process noise of its type. The steady motion is a
//! second filter of the same kind with little process noise. An agent that stands has the mean of its
//! positions. All three predict each measurement. As in an interacting multiple model filter, their
//! probabilities μ follow from their likelihoods Λ and from a Markov chain Π between them:
//!
//! ```text
//! c_j = Σ_i Π_ij μ_i      μ'_j = c_j Λ_j / Σ_i c_i Λ_i
//! ```
//!
//! [Blom, Bar-Shalom: *The interacting multiple model algorithm for systems with Markovian switching
//! coefficients*, 1988]
//!
//! Before each prediction, the steady motion and the position of standing take their share of the motions from
//! which the agent changed to them, Π_ij μ_i / c_j. Differs from the reference: the free motion takes no share
//! of the others. So gates, association and forecasts see every manoeuvre as without them.
//!
//! The published motion has the moments of all three.

use filters::{Filter, FilterFault, Gaussian, Models, Observation, STEP_MAX_NS, moments_near, wrapped};

use crate::fit::Fit;

/// Probabilities that an agent begins a manoeuvre, ends one, stops and starts between two measurements 80 ms
/// apart.
const BEGINS: f64 = 0.003;
const ENDS: f64 = 0.03;
const STOPS: f64 = 0.03;
const STARTS: f64 = 0.003;
/// Probability that a manoeuvre begins if there was no measurement for [`UNSEEN_NS`]. Only forecasts know of it,
/// and the free motion follows them.
const BEGINS_UNSEEN: f64 = 0.06;
const UNSEEN_NS: u64 = 500_000_000;
/// An agent stops from a speed below this, or below the deviation of its speed.
const STOPPING_MPS: f64 = 0.3;
/// Lower bound of each probability, so that a few measurements can change it.
const LEAST: f64 = 1e-6;
/// Probabilities of a new agent's motions: free, steady, standing.
const AT_BIRTH: [f64; 3] = [0.475, 0.475, 0.05];
/// Number of updates until the free motion is published alone: two positions fit any speed.
const UPDATES_MIN: u8 = 2;
/// Variance that the position of a standing agent gains in a second, m².
const CREEP_M2: f64 = 1e-3;
/// Variance of a standing agent's velocity, m²/s².
const STANDING_VARIANCE: f64 = 1e-4;
/// Probability of standing from which a heading without a measurement stays.
const STANDS: f64 = 0.5;

const STEADY: usize = 1;
const STANDING: usize = 2;

/// The motions beside the free one, and the probabilities of all three.
#[derive(Clone, Copy, Debug)]
pub struct Steady {
    filter: Filter,
    /// Position of a standing agent, and its variance per axis.
    place_m: [f64; 2],
    place_variance: f64,
    /// Of the free, the steady and the standing motion.
    probability: [f64; 3],
    /// Number of updates, up to [`UPDATES_MIN`].
    updates: u8,
    /// Time since the last update.
    unseen_ns: u64,
    changes: Changes,
}

/// Probabilities of changes between motions within a time.
#[derive(Clone, Copy, Debug)]
struct Changes {
    dt_ns: u64,
    begins: f64,
    begins_unseen: f64,
    ends: f64,
    stops: f64,
    starts: f64,
}

impl Changes {
    const IN_80_MS: Self = Self {
        dt_ns: STEP_MAX_NS,
        begins: BEGINS,
        begins_unseen: BEGINS_UNSEEN,
        ends: ENDS,
        stops: STOPS,
        starts: STARTS,
    };

    fn within(dt_ns: u64) -> Self {
        let steps = dt_ns as f64 / STEP_MAX_NS as f64;
        let within = |probability: f64| 1.0 - (1.0 - probability).powf(steps);
        let [begins, begins_unseen, ends, stops, starts] =
            [BEGINS, BEGINS_UNSEEN, ENDS, STOPS, STARTS].map(within);
        Self { dt_ns, begins, begins_unseen, ends, stops, starts }
    }
}

impl Steady {
    /// Motions that begin as the free one.
    #[must_use]
    pub fn new(free: &Filter) -> Self {
        let (place_m, [xx, _, yy]) = free.position();
        Self {
            filter: *free,
            place_m,
            place_variance: 0.5 * (xx + yy),
            probability: AT_BIRTH,
            updates: 0,
            unseen_ns: 0,
            changes: Changes::IN_80_MS,
        }
    }

    /// Begins again as the free motion if the free motion's filter is of another kind. Standing continues.
    pub fn follow_kind(&mut self, free: &Filter) {
        if self.filter.kind() != free.kind() {
            self.filter = *free;
        }
    }

    /// Takes the shares of the other motions and predicts `dt_ns` ahead.
    ///
    /// # Errors
    /// [`FilterFault`]; the steady motion is then unchanged.
    pub fn predict(&mut self, free: &Filter, dt_ns: u64, models: &Models) -> Result<(), FilterFault> {
        if self.changes.dt_ns != dt_ns {
            self.changes = Changes::within(dt_ns);
        }
        let Changes { ends, stops, starts, .. } = self.changes;
        let is_unseen = self.unseen_ns >= UNSEEN_NS;
        let begins = if is_unseen { self.changes.begins_unseen } else { self.changes.begins };
        self.unseen_ns = self.unseen_ns.saturating_add(dt_ns);
        let stops = stops * slowness(&self.filter);
        let [is_free, is_steady, stands] = self.probability;
        // A standing agent starts with a manoeuvre, and a free one stops.
        let next = [
            is_free * (1.0 - ends) * (1.0 - stops) + is_steady * begins + stands * starts,
            is_free * ends + is_steady * (1.0 - begins) * (1.0 - stops),
            (is_free * (1.0 - ends) + is_steady * (1.0 - begins)) * stops + stands * (1.0 - starts),
        ];
        self.filter = mixed(&self.filter, free, is_free * ends / next[STEADY]);
        let share = is_steady / (is_free + is_steady);
        self.stop_at(free, share, 1.0 - stands * (1.0 - starts) / next[STANDING]);
        self.place_variance += CREEP_M2 * dt_ns as f64 / 1e9;
        self.set(next);
        self.filter.predict(dt_ns, models)
    }

    /// Mixes the position of a moving agent into the position of standing. It moves steadily with the
    /// probability `is_steady`, and freely otherwise.
    fn stop_at(&mut self, free: &Filter, is_steady: f64, share: f64) {
        let ((free_m, free_m2), (steady_m, steady_m2)) = (free.position(), self.filter.position());
        let variance = |[xx, _, yy]: [f64; 3]| 0.5 * (xx + yy);
        let mut moving = (1.0 - is_steady) * variance(free_m2) + is_steady * variance(steady_m2);
        let mut spread = 0.0;
        for (own, (free, steady)) in self.place_m.iter_mut().zip(free_m.into_iter().zip(steady_m)) {
            let apart = steady - free;
            moving += 0.5 * is_steady * (1.0 - is_steady) * apart * apart;
            let off = free + is_steady * apart - *own;
            spread += 0.5 * share * (1.0 - share) * off * off;
            *own += share * off;
        }
        self.place_variance += share * (moving - self.place_variance) + spread;
    }

    /// Updates the motions and their probabilities by observations made `lag_s` after them, of which at most
    /// one is an observation of the agent. A single certain one shows which motion predicts better; `free` is
    /// the free motion before its update.
    ///
    /// # Errors
    /// [`FilterFault`]; the steady motion is then unchanged.
    pub fn update_at(
        &mut self,
        lag_s: f64,
        free: &Filter,
        possible: &[(f64, Observation)],
        models: &Models,
    ) -> Result<(), FilterFault> {
        let shifted =
            |filter: &Filter, dt_s: f64| if dt_s == 0.0 { *filter } else { filter.shifted(dt_s, models) };
        self.updates = (self.updates + 1).min(UPDATES_MIN);
        if !possible.is_empty() {
            self.unseen_ns = 0;
        }
        let mut moved = shifted(&self.filter, lag_s);
        if let [(1.0, observation)] = possible {
            let free = shifted(free, lag_s);
            let log_densities = [
                log_density(&free, observation),
                log_density(&moved, observation),
                self.log_density_standing(&moved, observation),
            ];
            let largest = log_densities.into_iter().fold(f64::NEG_INFINITY, f64::max);
            let mut weighed = self.probability;
            for (probability, log_density) in weighed.iter_mut().zip(log_densities) {
                *probability *= (log_density - largest).exp();
            }
            self.set(weighed);
            self.update_place(observation);
        }
        moved.update_jointly(possible, models)?;
        self.filter = shifted(&moved, -lag_s);
        Ok(())
    }

    fn update_place(&mut self, observation: &Observation) {
        let gain = self.place_variance / (self.place_variance + observation.position_variance);
        for (place, measured) in self.place_m.iter_mut().zip(observation.position_m) {
            *place += gain * (measured - *place);
        }
        self.place_variance *= 1.0 - gain;
    }

    /// Sets the probabilities to these shares. Shares that are not finite change nothing.
    fn set(&mut self, shares: [f64; 3]) {
        let sum: f64 = shares.iter().sum();
        if sum.is_finite() && sum > 0.0 {
            self.probability = shares.map(|share| (share / sum).max(LEAST));
        }
    }

    /// Moves the steady motion `dt_s` ahead (back if `dt_s` is negative) without process noise.
    pub fn shift(&mut self, dt_s: f64, models: &Models) {
        self.filter = self.filter.shifted(dt_s, models);
    }

    /// The motion to publish: the moments of all motions. The probabilities of the steady motion and of
    /// standing count by this share.
    #[must_use]
    pub fn published(&self, free: &Filter, share: f64) -> Filter {
        if share <= 0.0 || self.updates < UPDATES_MIN {
            return *free;
        }
        let sum: f64 = self.probability.iter().sum();
        let [_, steady, standing] = self.probability.map(|probability| share * probability / sum);
        let [is_free, is_steady, stands] = [1.0 - steady - standing, steady, standing];
        let variance = self.place_variance;
        match (free, &self.filter) {
            (Filter::ConstantVelocity(free), Filter::ConstantVelocity(steady)) => {
                let [x, y] = self.place_m;
                let standing = Gaussian::new(
                    [x, y, 0.0, 0.0],
                    [variance, variance, STANDING_VARIANCE, STANDING_VARIANCE],
                );
                Filter::ConstantVelocity(moments_near(
                    &[(is_steady, steady), (is_free, free), (stands, &standing)],
                    &[],
                ))
            }
            (Filter::Bicycle(free), Filter::Bicycle(steady)) => {
                let mut standing = *steady;
                let [x, y] = self.place_m;
                standing.mean[0] = x;
                standing.mean[1] = y;
                for (row, variance) in [(0, variance), (1, variance), (3, STANDING_VARIANCE)] {
                    standing.covariance.row_mut(row).fill(0.0);
                    standing.covariance.column_mut(row).fill(0.0);
                    standing.covariance[(row, row)] = variance;
                }
                standing.mean[3] = 0.0;
                standing.mean[4] = 0.0;
                Filter::Bicycle(moments_near(
                    &[(is_steady, steady), (is_free, free), (stands, &standing)],
                    &[2],
                ))
            }
            _ => *free,
        }
    }

    /// Mean spectral density of the acceleration, m²/s³. The free motion has the density of `models`. The
    /// probabilities of the steady motion and of standing count by this share.
    #[must_use]
    pub fn density(&self, models: &Models, share: f64) -> f64 {
        let [free, steady, standing] = self.probability;
        let is_quiet = share * (steady + standing) / (free + steady + standing);
        let [free, quiet] = [models, &models.steady()].map(|models| models.constant_velocity.density);
        free + is_quiet * (quiet - free)
    }

    /// Whether the agent probably stands.
    #[must_use]
    pub fn stands(&self) -> bool {
        self.updates == UPDATES_MIN
            && self.probability[STANDING] > STANDS * self.probability.iter().sum::<f64>()
    }

    /// Like [`log_density`], of an agent that stands. Its heading is the steady one.
    fn log_density_standing(&self, steady: &Filter, observation: &Observation) -> f64 {
        let off_m = [0, 1].map(|axis| observation.position_m[axis] - self.place_m[axis]);
        let variance = self.place_variance;
        let fit = fit(off_m, [variance, 0.0, variance], observation);
        let of_speed = |(speed_mps, sigma2): (f64, f64)| normal(speed_mps, STANDING_VARIANCE + sigma2);
        fit.log_density()
            + log_density_of_heading(steady, observation)
            + match steady {
                Filter::Bicycle(_) => observation.speed_mps.map_or(0.0, of_speed),
                Filter::ConstantVelocity(_) => 0.0,
            }
    }
}

/// 1 if the agent may stand by its motion, near 0 if it certainly moves.
fn slowness(filter: &Filter) -> f64 {
    let (speed2, variance) = match filter {
        Filter::Bicycle(state) => (state.mean[3].powi(2), state.covariance[(3, 3)]),
        Filter::ConstantVelocity(state) => {
            let (mean, covariance) = (&state.mean, &state.covariance);
            (mean[2] * mean[2] + mean[3] * mean[3], 0.5 * (covariance[(2, 2)] + covariance[(3, 3)]))
        }
    };
    (-0.5 * speed2 / (STOPPING_MPS * STOPPING_MPS + variance)).exp()
}

/// The moments of `from` with the weight 1 − `share` and of `other` with the weight `share`. Filters of
/// different kinds do not mix.
fn mixed(from: &Filter, other: &Filter, share: f64) -> Filter {
    match (from, other) {
        (Filter::ConstantVelocity(a), Filter::ConstantVelocity(b)) => {
            Filter::ConstantVelocity(moments_near(&[(1.0 - share, a), (share, b)], &[]))
        }
        (Filter::Bicycle(a), Filter::Bicycle(b)) => {
            Filter::Bicycle(moments_near(&[(1.0 - share, a), (share, b)], &[2]))
        }
        _ => *from,
    }
}

/// How well a measured position fits, this far off a predicted one of this covariance.
fn fit(off_m: [f64; 2], [xx, xy, yy]: [f64; 3], observation: &Observation) -> Fit {
    let [along, across] = observation.elongation;
    Fit::new(off_m, [xx + along, xy + across, yy - along], observation.position_variance)
}

/// Logarithm of a measurement's density under a predicted motion. Position, heading and speed count as
/// independent.
fn log_density(filter: &Filter, observation: &Observation) -> f64 {
    let (mean_m, covariance_m2) = filter.position();
    let off_m = [0, 1].map(|axis| observation.position_m[axis] - mean_m[axis]);
    let fit = fit(off_m, covariance_m2, observation);
    let of_speed = match (filter, observation.speed_mps) {
        (Filter::Bicycle(state), Some((speed_mps, variance))) => {
            normal(speed_mps - state.mean[3], state.covariance[(3, 3)] + variance)
        }
        _ => 0.0,
    };
    fit.log_density() + log_density_of_heading(filter, observation) + of_speed
}

fn log_density_of_heading(filter: &Filter, observation: &Observation) -> f64 {
    match (filter, observation.heading_rad) {
        (Filter::Bicycle(state), Some((heading_rad, variance))) => {
            normal(wrapped(heading_rad - state.mean[2]), state.covariance[(2, 2)] + variance)
        }
        _ => 0.0,
    }
}

/// Logarithm of a normal density, up to a constant.
fn normal(residual: f64, variance: f64) -> f64 {
    -0.5 * (residual * residual / variance + variance.ln())
}

#[cfg(test)]
mod tests;
