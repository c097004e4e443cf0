//! From controls to trajectories: the kinematic layer behind the network.
//!
//! The network predicts a Gaussian control u = μ + L ε per step and mode. This crate turns controls into
//! trajectories. A [`MotionModel`] is an agent with its equations of motion and its state at the end of its
//! history. Lengths are in m, times in s, and angles in rad, counter-clockwise from +x of the world frame.
//!
//! # Equations
//!
//! Vehicles are kinematic bicycles ([`Bicycle`], [`Vehicle`]). The state \[x, y, ψ, v, β\] is position,
//! heading, speed along the heading (negative in reverse) and slip angle. The control (a, β̇) is acceleration
//! in m/s² and slip rate in rad/s. l_r is the distance from the centre to the rear axle.
//!
//! ```text
//! x' = x + v* cos γ* Δt      ψ' = ψ + ω* Δt,  ω* = v* sin β* / l_r      β' = clip(β + β̇ Δt, ±β_max)
//! y' = y + v* sin γ* Δt      v' = v + a Δt
//! ```
//!
//! (v*, β*, γ*) are speed, slip angle and course at the beginning of the step (`Euler`) or in its middle
//! (`Midpoint`). Controls saturate smoothly, u ← u_max tanh(u / u_max).
//!
//! Cyclists and pedestrians move by [`Displacement`]s in the agent frame. R rotates them into the world
//! frame. The velocity is the last observed velocity and stays constant.
//!
//! ```text
//! p' = p + v Δt + R u   (residual)      p' = p + R u   (absolute)
//! ```
//!
//! # From controls to trajectories
//!
//! A [`MotionModel`] computes, step by step:
//!
//! * [`positions`](MotionModel::positions): the trajectory of the controls' means.
//! * [`moments`](MotionModel::moments): mean and covariance of the position as a *linearised Gaussian*
//!   ([`Belief::advance`]). The mean follows the equations of motion, the covariance their Jacobians.
//! * [`particle_moments`](MotionModel::particle_moments): the same by *Monte Carlo* ([`advance_particles`]),
//!   with particles that draw separate controls.
//!
//! The inverse, [`follow`](MotionModel::follow), finds controls that lead along a path.
//!
//! The modes of an agent form a [`mixture()`].
//!
//! A vehicle at 8 m/s that brakes at 2 m/s² and is uncertain of it:
//!
//! ```
//! use kinematics::{ControlGaussian, Moments, MotionKind, MotionModel, MotionOptions, MotionStart};
//!
//! let start = MotionStart { velocity_mps: [8.0, 0.0], length_m: Some(4.2), ..MotionStart::default() };
//! let vehicle = MotionModel::new(MotionKind::Bicycle, &start, &MotionOptions::default(), 0.4);
//!
//! let mut path_m = [[0.0; 2]; 5];
//! vehicle.positions(std::iter::repeat([-2.0, 0.0]), &mut path_m);
//! // 2 s on: 8 · 2 − ½ · 1.93 · 2² m, since an acceleration of −2 of at most 6 m/s² saturates to −1.93.
//! assert!((path_m[4][0] - 12.14).abs() < 0.01 && path_m[4][1] == 0.0);
//!
//! // Deviations of 0.5 m/s² and 0.02 rad/s, independent.
//! let control = ControlGaussian::new([-2.0, 0.0], [0.5, 0.0, 0.02]);
//! let mut moments = [Moments::default(); 5];
//! vehicle.moments(std::iter::repeat(vehicle.acting(&control)), &mut moments);
//! assert_eq!(moments[4].mean, path_m[4]);
//! let [along_m2, _, across_m2] = moments[4].covariance;
//! assert!(along_m2 > 0.1 && across_m2 > 0.1);
//! ```
//!
//! The bicycle is generic over the number type, so a filter can run the same equations in `f64`.

mod belief;
mod bicycle;
mod displacement;
mod elementary;
mod follow;
mod mixture;
mod model;
mod motion;
mod normals;
mod options;
mod particles;
mod vehicle;

pub use elementary::hypot;

pub use belief::{Belief, semidefinite_cholesky};
pub use bicycle::{Bicycle, BicycleState, Integrator, initial_slip, wrap_angle};
pub use displacement::{Displacement, DisplacementKind, DisplacementState};
pub use mixture::{Moments, mixture, spread};
pub use model::{MotionModel, MotionStart};
pub use motion::{ControlGaussian, Linearised, Motion};
pub use normals::Normals;
pub use options::{MotionKind, MotionOptions};
pub use particles::{PARTICLES_MAX, advance_particles};
pub use vehicle::{ControlLimits, Vehicle, saturate};
