//! Smoothing of the published history: later measurements improve earlier states.
//!
//! A filtered state knows nothing of later measurements, so neighbouring states have different errors. The
//! network reads accelerations and turn rates from their differences. The fixed-interval smoother goes back from
//! the newest state. The motion to a state's successor is a turn at constant rate, with a random acceleration of
//! spectral density q:
//!
//! ```text
//! x̂_k = x_k + G_k (x̂_k+1 − f(x_k))      G_k = P_k Fᵀ (F P_k Fᵀ + Q)⁻¹      F = [1 Δt; 0 1] per axis
//! ```
//!
//! [Rauch, Tung, Striebel: *Maximum likelihood estimates of linear dynamic systems*, 1965]
//!
//! The corrections x̂ − x follow from each other by [links](Link), which are computed once.
//!
//! Differs from the reference: P is the mean of both axes. Velocities are compared in the frame of the earlier
//! state. q is the mean of the densities of the free and the steady motion, by their probabilities.

use filters::{Filter, wrapped};
use wire::HistoryState;

/// The heading of an agent below this speed hardly follows its course.
const COURSE_MPS: f64 = 0.5;
/// Smallest determinant of a predicted covariance, m⁴/s², that can be inverted.
const DETERMINANT_MIN: f64 = 1e-18;

/// What smoothing needs of a state: its covariance per axis, and the motion around it.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// Variances of position and velocity, and their covariance.
    position_m2: f64,
    both_m2ps: f64,
    velocity_m2ps2: f64,
    turn_rate_radps: f64,
    /// Spectral density of the acceleration that led to the state, m²/s³.
    density: f64,
    /// Share of the correction that is applied: 0 for exact detections, 1 for noisy ones.
    share: f64,
}

impl Spread {
    /// A state that stays as it is.
    pub const NONE: Self = Self {
        position_m2: 0.0,
        both_m2ps: 0.0,
        velocity_m2ps2: 0.0,
        turn_rate_radps: 0.0,
        density: 0.0,
        share: 0.0,
    };

    /// The spread of a state. An acceleration of this spectral density led to it. At a share of 0, the state stays
    /// as it is.
    #[must_use]
    pub fn new(state: &Filter, rear_axle_m: f64, density: f64, share: f64) -> Self {
        if share <= 0.0 {
            return Self::NONE;
        }
        let covariance = state.cartesian().covariance;
        let mean =
            |row: usize, column: usize| 0.5 * (covariance[(row, column)] + covariance[(row + 1, column + 1)]);
        let turn_rate_radps = match state {
            Filter::Bicycle(state) => state.mean[3] * state.mean[4].sin() / rear_axle_m,
            Filter::ConstantVelocity(_) => 0.0,
        };
        Self {
            position_m2: mean(0, 0),
            both_m2ps: mean(0, 2),
            velocity_m2ps2: mean(2, 2),
            turn_rate_radps,
            density,
            share,
        }
    }

    /// Whether the state comes from noisy detections.
    #[must_use]
    pub const fn is_noisy(&self) -> bool {
        self.share > 0.0
    }

    /// The link of a state to its successor `dt_s` later, which has the spread `after`.
    #[must_use]
    pub fn link(&self, state: &HistoryState, (successor, after): (&HistoryState, &Self), dt_s: f64) -> Link {
        let Some(gain) = self.gain(after.density, dt_s) else { return Link::NONE };
        let (position_m, velocity_mps) = (position_m(state), self::velocity_mps(state));
        let (sin, cos) = (0.5 * self.turn_rate_radps * dt_s).sin_cos();
        let middle_mps = turned(velocity_mps, [cos, sin]);
        let back = [cos * cos - sin * sin, -2.0 * sin * cos];
        let before_mps = turned(self::velocity_mps(successor), back);
        let next_m = self::position_m(successor);
        let off_m = [0, 1].map(|axis| next_m[axis] - position_m[axis] - dt_s * middle_mps[axis]);
        let off_mps = [0, 1].map(|axis| before_mps[axis] - velocity_mps[axis]);
        let constant = gain
            .map(|[by_m, by_mps]| [0, 1].map(|axis| (by_m * off_m[axis] + by_mps * off_mps[axis]) as f32));
        let speed2 = velocity_mps[0].powi(2) + velocity_mps[1].powi(2);
        Link {
            constant,
            gain: gain.map(|row| row.map(|by| by as f32)),
            back: back.map(|part| part as f32),
            course_share: (speed2 / (speed2 + self.velocity_m2ps2 + COURSE_MPS * COURSE_MPS)) as f32,
        }
    }

    /// The rows of the gain G for position and velocity; `None` if the state stays as it is.
    fn gain(&self, density: f64, dt_s: f64) -> Option<[[f64; 2]; 2]> {
        if !self.is_noisy() {
            return None;
        }
        let &Self { position_m2, both_m2ps, velocity_m2ps2, share, .. } = self;
        // The rows of P Fᵀ, and the predicted covariance.
        let rows = [
            [position_m2 + dt_s * both_m2ps, both_m2ps],
            [both_m2ps + dt_s * velocity_m2ps2, velocity_m2ps2],
        ];
        let position = rows[0][0] + dt_s * rows[1][0] + density * dt_s.powi(3) / 3.0;
        let both = rows[1][0] + density * dt_s.powi(2) / 2.0;
        let velocity = velocity_m2ps2 + density * dt_s;
        let determinant = position * velocity - both * both;
        (determinant > DETERMINANT_MIN).then(|| {
            rows.map(|[a, b]| {
                [a * velocity - b * both, b * position - a * both].map(|by| share * by / determinant)
            })
        })
    }
}

/// How a state's correction follows from its successor's: d = G (x' − f(x)) + G R d'.
///
/// x' is the successor before its correction d', and R turns a velocity back into the frame of the earlier state.
/// So a state's link is computed once, when its successor is known.
#[derive(Clone, Copy, Debug)]
pub struct Link {
    /// G (x' − f(x)): of the position and of the velocity.
    constant: [[f32; 2]; 2],
    gain: [[f32; 2]; 2],
    /// Cosine and sine of the turn back.
    back: [f32; 2],
    /// How far the heading follows the course.
    course_share: f32,
}

impl Link {
    /// The link of a state that stays as it is.
    pub const NONE: Self =
        Self { constant: [[0.0; 2]; 2], gain: [[0.0; 2]; 2], back: [1.0, 0.0], course_share: 0.0 };

    /// The state's correction, from its successor's.
    #[must_use]
    pub fn correction(&self, [by_m, by_mps]: Correction) -> Correction {
        let [cos, sin] = self.back;
        let by_mps = [cos * by_mps[0] - sin * by_mps[1], sin * by_mps[0] + cos * by_mps[1]];
        [0, 1].map(|row| {
            let [of_m, of_mps] = self.gain[row];
            [0, 1].map(|axis| self.constant[row][axis] + of_m * by_m[axis] + of_mps * by_mps[axis])
        })
    }

    /// A state with its correction.
    #[must_use]
    pub fn corrected(&self, state: &HistoryState, [by_m, by_mps]: Correction) -> HistoryState {
        let &HistoryState { vx_mps, vy_mps, .. } = state;
        let [new_x, new_y] = [vx_mps + by_mps[0], vy_mps + by_mps[1]];
        let turn_rad = (vx_mps * new_y - vy_mps * new_x).atan2(vx_mps * new_x + vy_mps * new_y);
        let heading_rad = f64::from(state.heading_rad) + f64::from(self.course_share * turn_rad);
        HistoryState {
            x_m: state.x_m + by_m[0],
            y_m: state.y_m + by_m[1],
            vx_mps: new_x,
            vy_mps: new_y,
            heading_rad: wrapped(heading_rad) as f32,
            ..*state
        }
    }
}

/// Correction of a position, m, and of a velocity, m/s.
pub type Correction = [[f32; 2]; 2];

fn position_m(state: &HistoryState) -> [f64; 2] {
    [f64::from(state.x_m), f64::from(state.y_m)]
}

fn velocity_mps(state: &HistoryState) -> [f64; 2] {
    [f64::from(state.vx_mps), f64::from(state.vy_mps)]
}

/// A vector turned by an angle with this cosine and sine.
fn turned([x, y]: [f64; 2], [cos, sin]: [f64; 2]) -> [f64; 2] {
    [cos * x - sin * y, sin * x + cos * y]
}

#[cfg(test)]
mod tests {
    use filters::{Bicycle, ConstantVelocity, Gaussian, Integrator, Models, Observation};
    use nalgebra::{DMatrix, DVector};

    use super::*;

    const TICK_S: f64 = 0.08;
    const TICK_NS: u64 = 80_000_000;
    const DENSITY: f64 = 0.7;
    const MODELS: Models = Models {
        constant_velocity: ConstantVelocity { density: DENSITY },
        bicycle: Bicycle {
            rear_axle_m: 1.2,
            integrator: Integrator::Midpoint,
            acceleration_mps2: 0.5,
            slip_rate_radps: 0.05,
            slip_decay_per_s: 0.0,
            floor: [0.0; 5],
            slip_max_rad: 0.5,
        },
    };

    fn published(filter: &Filter) -> HistoryState {
        let motion = filter.motion();
        HistoryState {
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            heading_rad: motion.heading_rad.unwrap_or_default() as f32,
            present: 1,
        }
    }

    /// The filtered states after each position, and the same smoothed.
    fn played(start: Filter, positions_m: &[[f64; 2]], variance: f64) -> [Vec<HistoryState>; 2] {
        let mut filter = start;
        let (mut filtered, mut spreads) = (Vec::new(), Vec::new());
        for (tick, position_m) in positions_m.iter().enumerate() {
            if tick > 0 {
                filter.predict(TICK_NS, &MODELS).expect("a prediction");
            }
            filter
                .update_jointly(&[(1.0, Observation::of_position(*position_m, variance))], &MODELS)
                .expect("an update");
            filtered.push(published(&filter));
            spreads.push(Spread::new(&filter, MODELS.bicycle.rear_axle_m, DENSITY, 1.0));
        }
        let (mut smoothed, mut correction) = (filtered.clone(), Correction::default());
        for k in (0..smoothed.len() - 1).rev() {
            let link = spreads[k].link(&filtered[k], (&filtered[k + 1], &spreads[k + 1]), TICK_S);
            correction = link.correction(correction);
            smoothed[k] = link.corrected(&filtered[k], correction);
        }
        [filtered, smoothed]
    }

    /// Noise without an average, of about this deviation.
    fn noise(tick: usize, sigma_m: f64) -> [f64; 2] {
        [37.7, 91.3].map(|factor| sigma_m * std::f64::consts::SQRT_2 * (factor * (tick as f64 + 1.0)).sin())
    }

    /// The smoothed states are the most probable ones: those that solve all equations of motion and measurement
    /// at once by least squares.
    #[test]
    fn smoothed_states_are_the_least_squares_of_all_measurements() {
        const LEN: usize = 25;
        const VARIANCE: f64 = 0.04;
        let prior = [[9.0, 25.0], [-4.0, 25.0]];
        let positions_m: Vec<[f64; 2]> = (0..LEN)
            .map(|k| {
                let [x, y] = noise(k, 0.2);
                [8.0 * TICK_S * k as f64 + x, -3.0 * TICK_S * k as f64 + y]
            })
            .collect();
        let start = Gaussian::new([0.0, 0.0, prior[0][0], prior[1][0]], [1.0, 1.0, prior[0][1], prior[1][1]]);
        let [filtered, smoothed] = played(Filter::ConstantVelocity(start), &positions_m, VARIANCE);
        // Information of [p, v] at all times: of the prior, of each measurement and of each motion.
        let mut farthest_m = 0.0_f64;
        for axis in 0..2 {
            let (mut information, mut of_data) = (DMatrix::zeros(2 * LEN, 2 * LEN), DVector::zeros(2 * LEN));
            information[(0, 0)] += 1.0;
            information[(1, 1)] += 1.0 / prior[axis][1];
            of_data[1] += prior[axis][0] / prior[axis][1];
            for (k, position_m) in positions_m.iter().enumerate() {
                information[(2 * k, 2 * k)] += 1.0 / VARIANCE;
                of_data[2 * k] += position_m[axis] / VARIANCE;
            }
            let motion_noise = DMatrix::from_row_slice(
                2,
                2,
                &[
                    DENSITY * TICK_S.powi(3) / 3.0,
                    DENSITY * TICK_S.powi(2) / 2.0,
                    DENSITY * TICK_S.powi(2) / 2.0,
                    DENSITY * TICK_S,
                ],
            );
            let weight = motion_noise.try_inverse().expect("noise in all directions");
            // x' − F x of two consecutive states.
            let change = DMatrix::from_row_slice(2, 4, &[-1.0, -TICK_S, 1.0, 0.0, 0.0, -1.0, 0.0, 1.0]);
            let of_motion = change.transpose() * weight * change;
            for k in 0..LEN - 1 {
                let mut of_both = information.view_mut((2 * k, 2 * k), (4, 4));
                of_both += &of_motion;
            }
            let most_probable = information.cholesky().expect("positive definite").solve(&of_data);
            for (k, (smoothed, filtered)) in smoothed.iter().zip(&filtered).enumerate() {
                let [position_m, velocity_mps] = [position_m(smoothed)[axis], velocity_mps(smoothed)[axis]];
                assert!((position_m - most_probable[2 * k]).abs() < 1e-5, "{k}: {position_m} m");
                assert!((velocity_mps - most_probable[2 * k + 1]).abs() < 1e-5, "{k}: {velocity_mps} m/s");
                farthest_m = farthest_m.max((position_m - self::position_m(filtered)[axis]).abs());
            }
        }
        assert!(farthest_m > 0.05, "smoothing moves states by at most {farthest_m} m");
    }

    /// `tests/reference/smoothing.py` smooths in float64, by the matrices of the equations.
    #[test]
    fn smoothed_states_equal_the_reference() {
        let csv = include_str!("../tests/reference/smoothing.csv");
        let rows: Vec<Vec<f64>> = csv
            .lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
            .collect();
        let read = |row: &[f64]| {
            let [time_ms, turn_rate_radps, density, position_m2, both_m2ps, velocity_m2ps2, ref states @ ..] =
                *row
            else {
                panic!("{row:?}")
            };
            let spread =
                Spread { position_m2, both_m2ps, velocity_m2ps2, turn_rate_radps, density, share: 1.0 };
            let state = HistoryState {
                x_m: states[0] as f32,
                y_m: states[1] as f32,
                vx_mps: states[2] as f32,
                vy_mps: states[3] as f32,
                heading_rad: 0.0,
                present: 1,
            };
            (time_ms, spread, state)
        };
        let mut correction = Correction::default();
        for pair in rows.windows(2).rev() {
            let ((from_ms, spread, state), (to_ms, after, successor)) = (read(&pair[0]), read(&pair[1]));
            let link = spread.link(&state, (&successor, &after), (to_ms - from_ms) / 1e3);
            correction = link.correction(correction);
            let found = link.corrected(&state, correction);
            let found = [found.x_m, found.y_m, found.vx_mps, found.vy_mps].map(f64::from);
            for (found, expected) in found.iter().zip(&pair[0][10..]) {
                assert!((found - expected).abs() < 2e-5, "{found}, {expected} at {from_ms} ms");
            }
        }
    }

    /// A vehicle that turns by 0.5 rad/s: the smoothed states are nearer to the circle, and so are their
    /// headings.
    #[test]
    fn a_turn_stays_a_turn() {
        const SPEED_MPS: f64 = 8.0;
        const RATE_RADPS: f64 = 0.5;
        let truth = |k: usize| {
            let (sin, cos) = (RATE_RADPS * TICK_S * k as f64).sin_cos();
            let radius_m = SPEED_MPS / RATE_RADPS;
            ([radius_m * sin, radius_m * (1.0 - cos)], RATE_RADPS * TICK_S * k as f64)
        };
        let positions_m: Vec<[f64; 2]> = (0..60)
            .map(|k| {
                let ([x, y], [by_x, by_y]) = (truth(k).0, noise(k, 0.3));
                [x + by_x, y + by_y]
            })
            .collect();
        let slip_rad = (RATE_RADPS * MODELS.bicycle.rear_axle_m / SPEED_MPS).asin();
        let start = Gaussian::new([0.0, 0.0, -slip_rad, SPEED_MPS, slip_rad], [0.1, 0.1, 0.05, 1.0, 0.01]);
        let [filtered, smoothed] = played(Filter::Bicycle(start), &positions_m, 0.09);
        let errors = |states: &[HistoryState]| {
            states[20..50].iter().enumerate().fold([0.0; 2], |[by_m, by_rad], (k, state)| {
                let (place_m, course_rad) = truth(20 + k);
                let [x, y] = position_m(state);
                let off_rad = wrapped(f64::from(state.heading_rad) + slip_rad - course_rad);
                [by_m + (x - place_m[0]).hypot(y - place_m[1]), by_rad + off_rad.abs()]
            })
        };
        let ([before_m, before_rad], [after_m, after_rad]) = (errors(&filtered), errors(&smoothed));
        assert!(after_m < 0.8 * before_m, "{after_m} m of {before_m} m");
        assert!(after_rad < 0.8 * before_rad, "{after_rad} rad of {before_rad} rad");
    }

    #[test]
    fn exact_states_have_no_correction() {
        let filter = Filter::ConstantVelocity(Gaussian::new([1.0, 2.0, 3.0, 4.0], [0.1; 4]));
        let (state, other) = (published(&filter), HistoryState { x_m: 9.0, ..published(&filter) });
        for spread in [Spread::NONE, Spread::new(&filter, 1.2, DENSITY, 0.0)] {
            let link = spread.link(&state, (&other, &spread), TICK_S);
            assert_eq!(link.correction([[1.0; 2]; 2]), Correction::default());
        }
    }
}
