//! The kinematic bicycle of `kinematics::Bicycle` with saturated controls, for many vehicles in parallel.
//! \[model §4\]
//!
//! A step is evaluated at the share h of its duration: 0 for Euler's integrator, ½ for the midpoint rule.
//!
//! ```text
//! v' = v + a Δt                 v* = v + h (v' − v)       x' = x + v* cos γ* Δt
//! β' = clip(β + β̇ Δt)           β* = β + h (β' − β)       y' = y + v* sin γ* Δt
//! γ* = ψ + h ω* Δt + β*         ω* = v* sin β* / l_r      ψ' = ψ + ω* Δt
//! ```

use kinematics::{BicycleState, Vehicle};
use nn::kernels::{Kernel, Lanes, dispatch};
use nn::{Integrator, ModelConfig};

use super::super::matrix::Matrix;
use super::reals::Reals;

/// State of an agent at the last observed step, at the origin of its frame. Cyclists and pedestrians use only
/// the velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Start {
    /// In the agent frame, m/s.
    pub(crate) velocity_mps: [f32; 2],
    /// In the agent frame, rad.
    pub(crate) heading_rad: f32,
    /// Along the heading, negative in reverse, m/s.
    pub(crate) speed_mps: f32,
    pub(crate) slip_rad: f32,
    /// Distance from the centre to the rear axle, m; positive for vehicles.
    pub(crate) rear_axle_m: f32,
}

impl Start {
    /// The bicycle of a vehicle, and its initial state.
    pub(crate) fn bicycle(&self, config: &ModelConfig) -> (Vehicle, BicycleState<f32>) {
        let motion = nn::motion_options(config).vehicle(self.rear_axle_m, config.dt_s as f32);
        (motion, BicycleState::from([0.0, 0.0, self.heading_rad, self.speed_mps, self.slip_rad]))
    }
}

/// Largest number of lanes of an instruction set.
const LANES_MAX: usize = 16;

/// As [`super::positions`], for vehicles.
pub(super) fn positions(
    config: &ModelConfig,
    starts: &[Start],
    draw_count: usize,
    controls: &Matrix,
) -> Matrix {
    let vehicles = Vehicles { bicycle: Bicycle::new(config), starts, draw_count, controls };
    let mut positions = Matrix::zeros(controls.rows, controls.cols);
    dispatch(Forward { vehicles, positions: &mut positions });
    positions
}

/// As [`super::positions_backward`], for vehicles.
pub(super) fn positions_backward(
    config: &ModelConfig,
    starts: &[Start],
    draw_count: usize,
    controls: &Matrix,
    d_positions: &Matrix,
) -> Matrix {
    let vehicles = Vehicles { bicycle: Bicycle::new(config), starts, draw_count, controls };
    let mut d_controls = Matrix::zeros(controls.rows, controls.cols);
    dispatch(Backward { vehicles, d_positions, d_controls: &mut d_controls });
    d_controls
}

/// Parameters that all vehicles share.
#[derive(Clone, Copy)]
struct Bicycle {
    dt_s: f32,
    accel_limit_mps2: f32,
    slip_rate_limit_radps: f32,
    /// [`f32::MAX`] if there is no limit.
    slip_limit_rad: f32,
    /// h: evaluation point of a step, as a share of its duration.
    evaluated_at: f32,
}

/// A state without its position, or the gradient by it.
#[derive(Clone, Copy)]
struct State<L: Lanes> {
    heading: Reals<L>,
    speed: Reals<L>,
    slip: Reals<L>,
}

/// Intermediate values of a step.
#[derive(Clone, Copy)]
struct Step<L: Lanes> {
    /// Controls divided by their limits, in ± 1.
    shares: [Reals<L>; 2],
    /// 1 if the slip after the step is within its limit, 0 if it is clipped.
    slip_is_free: Reals<L>,
    speed: Reals<L>,
    slip_sin: Reals<L>,
    slip_cos: Reals<L>,
    course_sin: Reals<L>,
    course_cos: Reals<L>,
}

impl Bicycle {
    fn new(config: &ModelConfig) -> Self {
        Self {
            dt_s: config.dt_s as f32,
            accel_limit_mps2: config.accel_limit_mps2,
            slip_rate_limit_radps: config.slip_rate_limit_radps,
            slip_limit_rad: config.slip_limit_rad.unwrap_or(f32::MAX),
            evaluated_at: match config.integrator {
                Integrator::Euler => 0.0,
                Integrator::Midpoint => 0.5,
            },
        }
    }

    /// Intermediate values of the step from `state` under `controls` before saturation, and the next state.
    #[inline(always)]
    fn step<L: Lanes>(
        &self,
        state: State<L>,
        rear_axle: Reals<L>,
        controls: [Reals<L>; 2],
    ) -> (Step<L>, State<L>) {
        let State { heading, speed, slip } = state;
        let shares = [
            (controls[0] * self.accel_limit_mps2.recip()).tanh(),
            (controls[1] * self.slip_rate_limit_radps.recip()).tanh(),
        ];
        let next_speed = speed + shares[0] * (self.accel_limit_mps2 * self.dt_s);
        let asked_slip = slip + shares[1] * (self.slip_rate_limit_radps * self.dt_s);
        let (next_slip, slip_is_free) = asked_slip.clamp(self.slip_limit_rad);
        let speed = speed + (next_speed - speed) * self.evaluated_at;
        let slip = slip + (next_slip - slip) * self.evaluated_at;
        let (slip_sin, slip_cos) = slip.sin_cos();
        let turn = speed * slip_sin / rear_axle * self.dt_s;
        let (course_sin, course_cos) = (heading + turn * self.evaluated_at + slip).sin_cos();
        let step = Step { shares, slip_is_free, speed, slip_sin, slip_cos, course_sin, course_cos };
        (step, State { heading: heading + turn, speed: next_speed, slip: next_slip })
    }

    /// Displacement of a step.
    #[inline(always)]
    fn displacement<L: Lanes>(&self, step: &Step<L>) -> [Reals<L>; 2] {
        let travelled = step.speed * self.dt_s;
        [travelled * step.course_cos, travelled * step.course_sin]
    }

    /// Gradients by the state before a step and by the controls, given the gradients by the next state and by
    /// the position.
    #[inline(always)]
    fn backward<L: Lanes>(
        &self,
        step: &Step<L>,
        rear_axle: Reals<L>,
        next: State<L>,
        by_position: [Reals<L>; 2],
    ) -> (State<L>, [Reals<L>; 2]) {
        let (h, dt_s) = (self.evaluated_at, self.dt_s);
        let along = by_position[0] * step.course_cos + by_position[1] * step.course_sin;
        let across = by_position[1] * step.course_cos - by_position[0] * step.course_sin;
        let by_course = step.speed * across * dt_s;
        let by_turn_rate = (next.heading + by_course * h) * dt_s / rear_axle;
        let at_speed = along * dt_s + by_turn_rate * step.slip_sin;
        let at_slip = by_course + by_turn_rate * step.speed * step.slip_cos;
        let next_speed = next.speed + at_speed * h;
        let asked_slip = (next.slip + at_slip * h) * step.slip_is_free;
        let state = State {
            heading: next.heading + by_course,
            speed: next_speed + at_speed * (1.0 - h),
            slip: asked_slip + at_slip * (1.0 - h),
        };
        // The slope of the saturation is 1 − tanh².
        let [accel_slope, slip_rate_slope] = step.shares.map(|share| (share * share) * -dt_s + dt_s);
        (state, [next_speed * accel_slope, asked_slip * slip_rate_slope])
    }
}

/// Trajectories of vehicles, one per row of the controls.
#[derive(Clone, Copy)]
struct Vehicles<'a> {
    bicycle: Bicycle,
    starts: &'a [Start],
    draw_count: usize,
    controls: &'a Matrix,
}

impl Vehicles<'_> {
    /// Initial states and rear axle distances of the rows from `first` on.
    #[inline(always)]
    fn start<L: Lanes>(&self, lanes: L, first: usize) -> (State<L>, Reals<L>) {
        let of_rows = |value: fn(&Start) -> f32| {
            let mut values = [0.0; LANES_MAX];
            for (lane, lane_value) in values[..L::LEN].iter_mut().enumerate() {
                let row = (first + lane).min(self.controls.rows - 1);
                *lane_value = value(&self.starts[row / self.draw_count]);
            }
            Reals::load(lanes, &values)
        };
        let state = State {
            heading: of_rows(|start| start.heading_rad),
            speed: of_rows(|start| start.speed_mps),
            slip: of_rows(|start| start.slip_rad),
        };
        (state, of_rows(|start| start.rear_axle_m))
    }
}

/// Some rows of a matrix as columns, for loads and stores of whole vectors.
struct Columns(Vec<[f32; LANES_MAX]>);

impl Columns {
    fn new(len: usize) -> Self {
        Self(vec![[0.0; LANES_MAX]; len])
    }

    /// Gathers one row per lane from `first` on. The last row repeats at the end of the matrix.
    #[inline(always)]
    fn gather<L: Lanes>(&mut self, matrix: &Matrix, first: usize) {
        for lane in 0..L::LEN {
            let row = matrix.row((first + lane).min(matrix.rows - 1));
            self.0.iter_mut().zip(row).for_each(|(column, value)| column[lane] = *value);
        }
    }

    /// Writes the rows from `first` on, up to the end of the matrix.
    #[inline(always)]
    fn scatter<L: Lanes>(&self, matrix: &mut Matrix, first: usize) {
        for lane in 0..L::LEN.min(matrix.rows - first) {
            let row = matrix.row_mut(first + lane);
            row.iter_mut().zip(&self.0).for_each(|(value, column)| *value = column[lane]);
        }
    }

    /// Both components of a step.
    #[inline(always)]
    fn load<L: Lanes>(&self, lanes: L, step: usize) -> [Reals<L>; 2] {
        [0, 1].map(|axis| Reals::load(lanes, &self.0[2 * step + axis]))
    }

    #[inline(always)]
    fn store<L: Lanes>(&mut self, step: usize, values: [Reals<L>; 2]) {
        for (column, values) in self.0[2 * step..].iter_mut().zip(values) {
            values.store(column);
        }
    }
}

struct Forward<'a> {
    vehicles: Vehicles<'a>,
    positions: &'a mut Matrix,
}

impl Kernel for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self { vehicles, positions } = self;
        let mut columns = Columns::new(positions.cols);
        for first in (0..positions.rows).step_by(L::LEN) {
            columns.gather::<L>(vehicles.controls, first);
            let (mut state, rear_axle) = vehicles.start(lanes, first);
            let mut position = [Reals::splat(lanes, 0.0); 2];
            for number in 0..positions.cols / 2 {
                let (step, next) = vehicles.bicycle.step(state, rear_axle, columns.load(lanes, number));
                let [x, y] = vehicles.bicycle.displacement(&step);
                position = [position[0] + x, position[1] + y];
                columns.store(number, position);
                state = next;
            }
            columns.scatter::<L>(positions, first);
        }
    }
}

struct Backward<'a> {
    vehicles: Vehicles<'a>,
    d_positions: &'a Matrix,
    d_controls: &'a mut Matrix,
}

impl Kernel for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self { vehicles, d_positions, d_controls } = self;
        let step_count = d_controls.cols / 2;
        let (mut columns, mut steps) = (Columns::new(d_controls.cols), Vec::with_capacity(step_count));
        for first in (0..d_controls.rows).step_by(L::LEN) {
            columns.gather::<L>(vehicles.controls, first);
            let (mut state, rear_axle) = vehicles.start(lanes, first);
            steps.clear();
            for number in 0..step_count {
                let (step, next) = vehicles.bicycle.step(state, rear_axle, columns.load(lanes, number));
                steps.push(step);
                state = next;
            }
            columns.gather::<L>(d_positions, first);
            let zero = Reals::splat(lanes, 0.0);
            let mut by_position = [zero; 2];
            let mut by_state = State { heading: zero, speed: zero, slip: zero };
            for (number, step) in steps.iter().enumerate().rev() {
                let [x, y] = columns.load(lanes, number);
                by_position = [by_position[0] + x, by_position[1] + y];
                let (before, by_controls) = vehicles.bicycle.backward(step, rear_axle, by_state, by_position);
                columns.store(number, by_controls);
                by_state = before;
            }
            columns.scatter::<L>(d_controls, first);
        }
    }
}
