//! How controls become motion: the kinematic layer that ends the network.
//!
//! A [`Motion`] takes an agent one step further under a control. Vehicles follow a kinematic [`Bicycle`] steered by
//! acceleration and slip rate; cyclists and pedestrians add a [`Displacement`] per step. The network gives each control
//! as a Gaussian, and there are two ways to carry it through a motion: a *linearised Gaussian* ([`Belief::advance`],
//! mean through the motion itself, covariance through its Jacobians) and *Monte Carlo* ([`advance_particles`]).
//!
//! The bicycle is generic over the number type, so that a filter can run the same equations in `f64`.

mod belief;
mod bicycle;
mod displacement;
mod mixture;
mod motion;
mod normals;
mod particles;
mod vehicle;

pub use belief::{Belief, semidefinite_cholesky};
pub use bicycle::{Bicycle, BicycleState, Integrator, initial_slip, wrap_angle};
pub use displacement::{Displacement, DisplacementKind, DisplacementState};
pub use mixture::{Moments, mixture, spread};
pub use motion::{ControlGaussian, Linearised, Motion};
pub use normals::Normals;
pub use particles::{PARTICLES_MAX, advance_particles};
pub use vehicle::{ControlLimits, Vehicle, saturate};
