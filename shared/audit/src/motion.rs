//! The expected position of an agent, by a filter that forgets.
//!
//! ```text
//! r = z - (x + v Δt)      x' = z - θ² r      v' = v + (1 - θ)² r / Δt      θ = exp(-Δt / τ)
//! ```
//!
//! The velocity of a single step has the noise of two positions: at 10 Hz, 0.2 m are 2.8 m/s.

/// The filter's memory τ. In this time an agent can't change its velocity much.
const MEMORY_S: f64 = 0.25;

/// Position and velocity of an agent at its newest detection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    position_m: [f64; 2],
    /// `None` before the second detection.
    pub velocity_mps: Option<[f64; 2]>,
    /// Whether the velocity comes from more than one step.
    pub is_sure: bool,
}

impl Motion {
    pub const fn new(position_m: [f64; 2]) -> Self {
        Self { position_m, velocity_mps: None, is_sure: false }
    }

    /// The way from the expected position to a position at a later time.
    pub fn off_m(&self, to_m: [f64; 2], elapsed_s: f64) -> [f64; 2] {
        let velocity_mps = self.velocity_mps.unwrap_or_default();
        [0, 1].map(|axis| to_m[axis] - self.position_m[axis] - velocity_mps[axis] * elapsed_s)
    }

    /// Advances to the next detection.
    pub fn advance(&mut self, to_m: [f64; 2], elapsed_s: f64) {
        let off_m = self.off_m(to_m, elapsed_s);
        let Some(velocity_mps) = self.velocity_mps else {
            (self.position_m, self.velocity_mps) = (to_m, Some(off_m.map(|off_m| off_m / elapsed_s)));
            return;
        };
        let kept = (-elapsed_s / MEMORY_S).exp();
        let gain = (1.0 - kept).powi(2) / elapsed_s;
        self.position_m = [0, 1].map(|axis| to_m[axis] - kept * kept * off_m[axis]);
        self.is_sure = true;
        self.velocity_mps = Some([0, 1].map(|axis| velocity_mps[axis] + gain * off_m[axis]));
    }
}
