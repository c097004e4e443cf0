use filters::{Filter, Gaussian};
use wire::{Quality, Track, TrackStatus};

use super::Estimate;

impl Estimate {
    /// Writes the estimate to the published track. `step_ns` is Δt.
    pub fn write(&self, step_ns: u64, track: &mut Track) {
        let motion = &self.published.motion;
        let status = if self.management.was_hit() { TrackStatus::Confirmed } else { TrackStatus::Coasting };
        track.source_id = self.source_id;
        track.born_ns = self.birth.stamp_ns;
        track.unseen_ns = self.unseen_ns(self.stamp_ns);
        track.agent_type = self.class.current() as u32;
        track.status = status as u32;
        [track.x_m, track.y_m] = motion.position_m.map(|x| x as f32);
        [track.vx_mps, track.vy_mps] = motion.velocity_mps.map(|v| v as f32);
        track.speed_mps = motion.speed_mps as f32;
        track.slip_rad = motion.slip_rad as f32;
        track.length_m = self.size.length_m;
        track.width_m = self.size.width_m;
        track.existence = self.management.existence_probability() as f32;
        track.type_probability = self.class.probability().map(|p| p as f32);
        track.state_len = match &self.published.state {
            Filter::Bicycle(state) => write_covariance(state, &mut track.covariance),
            other => write_covariance(&other.cartesian(), &mut track.covariance),
        };
        self.write_prior(step_ns, track);
    }

    fn write_prior(&self, step_ns: u64, track: &mut Track) {
        let age_ns = self.belief.forecast_age_ns();
        // Uses the age at the beginning of the step to this state.
        let prior = match age_ns.map(|age_ns| age_ns.saturating_sub(self.dt_ns)) {
            None => Quality::Kinematic,
            Some(age_ns) if age_ns < step_ns => Quality::Learned,
            Some(_) => Quality::Held,
        };
        track.prior = prior as u32;
        track.prior_age_ns = age_ns.unwrap_or(0);
        track.prior_weights = self.belief.weights();
    }
}

/// Writes the covariance row by row, followed by zeros. For a symmetric matrix this equals column by column.
/// Returns the number of rows.
fn write_covariance<const N: usize>(state: &Gaussian<N>, numbers: &mut [f32; 25]) -> u32 {
    let (own, rest) = numbers.split_at_mut(N * N);
    for (number, value) in own.iter_mut().zip(state.covariance.as_slice()) {
        *number = *value as f32;
    }
    rest.fill(0.0);
    N as u32
}
