use nalgebra::{SVector, Vector2};

use crate::{ControlGaussian, Motion, Normals};

/// Largest number of particles of a mode.
pub const PARTICLES_MAX: usize = 32;

/// Moves particles one step ahead. Each particle draws its own control, saturates it and moves. \[paper,
/// Monte Carlo\]
pub fn advance_particles<const N: usize>(
    motion: &impl Motion<N>,
    control: &ControlGaussian,
    particles: &mut [SVector<f32, N>],
    normals: &mut Normals,
) {
    for particle in particles {
        let noise = Vector2::new(normals.draw(), normals.draw());
        let (acting, _) = motion.saturate(&(control.mean + control.cholesky * noise));
        *particle = motion.step(particle, &acting);
    }
}
