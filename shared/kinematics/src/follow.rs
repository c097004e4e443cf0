//! Controls along a path: the inverse of [`MotionModel::positions`](crate::MotionModel::positions).
//!
//! A bicycle cannot follow every path. Before each step it is predicted two steps ahead without control. The
//! deviation from the path after one and two steps is e₁ and e₂ along the course, and n₁ and n₂ to the left.
//! The acceleration and slip rate below, if held for two steps, correct this deviation best in the
//! least-squares sense:
//!
//! ```text
//! a = (e₁/2 + 2 e₂) / (17/4 Δt²)        β̇ = (g₁ n₁ + g₂ n₂) / (g₁² + g₂² + ε²)
//! g₁ = A₁ Δt / 2,  g₂ = (A₁ + d₁ κ₁ + 3 A₂) Δt / 2,  A = d (1 + κ/2),  κ = d / l_r,  d = v Δt
//! ```
//!
//! The control is applied for one step, and the next step sees the remaining deviation. A control that meets
//! each position in turn would overshoot and reverse at the next step; looking two steps ahead damps this.

use nalgebra::{Matrix2, Vector2};

use crate::{BicycleState, Displacement, DisplacementState, Motion, Vehicle};

/// ε: an agent that moves less than this in two steps does not turn towards its path, m s.
const TURN_MIN_MS: f32 = 0.05;
/// Largest control, as a share of its saturation.
const SHARE_MAX: f32 = 0.999;

impl Vehicle {
    /// Writes controls, before saturation, that lead from a state along a path of one position per step.
    pub(crate) fn follow(&self, start: &BicycleState<f32>, path_m: &[[f32; 2]], controls: &mut [[f32; 2]]) {
        let mut state = *start;
        for (step, control) in controls.iter_mut().enumerate().take(path_m.len()) {
            let near_m = Vector2::from(path_m[step]);
            let far_m = match path_m.get(step + 1) {
                Some(&far_m) => Vector2::from(far_m),
                None => {
                    2.0 * near_m - step.checked_sub(1).map_or(position(start), |before| path_m[before].into())
                }
            };
            let acting = self.towards(&state, near_m, far_m);
            state = self.step(&state, &acting);
            *control = [
                before_saturation(acting.x, self.limits.accel_mps2),
                before_saturation(acting.y, self.limits.slip_rate_radps),
            ];
        }
    }

    /// The saturated control towards the positions after one and two steps.
    fn towards(&self, state: &BicycleState<f32>, near_m: Vector2<f32>, far_m: Vector2<f32>) -> Vector2<f32> {
        let free = Vector2::zeros();
        let after = self.step(state, &free);
        let later = self.step(&after, &free);
        let (sin, cos) = (later[2] + later[4]).sin_cos();
        let along_left = Matrix2::new(cos, sin, -sin, cos);
        let (near, far) = (along_left * (near_m - position(&after)), along_left * (far_m - position(&later)));

        let dt_s = self.dt_s;
        let limited = |control: f32, limit: f32| control.clamp(-SHARE_MAX * limit, SHARE_MAX * limit);
        let accel_mps2 = limited((0.5 * near.x + 2.0 * far.x) / (4.25 * dt_s * dt_s), self.limits.accel_mps2);

        let [first_m, second_m] = [0.5, 1.5].map(|steps| (state[3] + steps * accel_mps2 * dt_s) * dt_s);
        let sideways = |advance_m: f32| advance_m * (1.0 + 0.5 * advance_m / self.bicycle.rear_axle_m);
        let turned = second_m * first_m / self.bicycle.rear_axle_m;
        let by_near = 0.5 * dt_s * sideways(first_m);
        let by_far = 0.5 * dt_s * (sideways(first_m) + turned + 3.0 * sideways(second_m));
        let least = by_near * by_near + by_far * by_far + TURN_MIN_MS * TURN_MIN_MS;
        let slip_rate_radps = (by_near * near.y + by_far * far.y) / least;
        Vector2::new(accel_mps2, limited(slip_rate_radps, self.limits.slip_rate_radps))
    }
}

impl Displacement {
    /// Writes the displacements that lead exactly along a path of one position per step.
    pub(crate) fn follow(&self, start: &DisplacementState, path_m: &[[f32; 2]], controls: &mut [[f32; 2]]) {
        let mut state = *start;
        for (control, &to_m) in controls.iter_mut().zip(path_m) {
            let free = self.step(&state, &Vector2::zeros());
            let acting = self.in_agent_frame(Vector2::from(to_m) - free.fixed_rows::<2>(0));
            state = self.step(&state, &acting);
            *control = acting.into();
        }
    }
}

fn position(state: &BicycleState<f32>) -> Vector2<f32> {
    Vector2::new(state[0], state[1])
}

/// The control whose saturation is `acting`: limit · artanh(acting / limit).
fn before_saturation(acting: f32, limit: f32) -> f32 {
    limit * (acting / limit).atanh()
}
