use bytemuck::Zeroable;
use filters::{Filter, Gaussian};
use wire::{Quality, Track, TrackStatus};

use crate::estimate::Estimate;

impl Estimate {
    /// Its part of the track that is published; `step_ns` is Δt.
    #[must_use]
    pub fn track(&self, step_ns: u64) -> Track {
        let motion = &self.motion;
        let status = if self.life.is_hit() { TrackStatus::Confirmed } else { TrackStatus::Coasting };
        let prior_age_ns = self.belief.forecast_age_ns();
        // By its age when it began to move the state here.
        let prior = match prior_age_ns.map(|age_ns| age_ns.saturating_sub(self.moved_ns)) {
            None => Quality::Kinematic,
            Some(age_ns) if age_ns < step_ns => Quality::Learned,
            Some(_) => Quality::Held,
        };
        let (state_len, covariance) = match self.belief.filter() {
            Filter::Bicycle(state) => (5, row_major(state)),
            other => (4, row_major(&other.cartesian())),
        };
        Track {
            source_id: self.source_id,
            born_ns: self.birth.stamp_ns,
            unseen_ns: self.unseen_ns(self.stamp_ns),
            agent_type: self.class.current() as u32,
            status: status as u32,
            state_len,
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            speed_mps: motion.speed_mps as f32,
            slip_rad: motion.slip_rad as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            length_m: self.length_m,
            width_m: self.width_m,
            existence: self.life.probability() as f32,
            type_probability: self.class.probability().map(|p| p as f32),
            covariance,
            prior: prior as u32,
            prior_age_ns: prior_age_ns.unwrap_or(0),
            prior_weights: self.belief.weights(),
            ..Track::zeroed()
        }
    }
}

fn row_major<const N: usize>(state: &Gaussian<N>) -> [f32; 25] {
    let mut numbers = [0.0; 25];
    for (number, value) in numbers.iter_mut().zip(state.covariance.transpose().iter()) {
        *number = *value as f32;
    }
    numbers
}
