//! The learned prior by Monte Carlo: a particle filter whose particles follow the controls of a forecast's
//! draws.
//!
//! Every particle is a state and the number of a hypothesis (`None` for the kinematic process). It draws its
//! own noise, so nothing is linearised. A measurement weighs a particle by its density. The processes and the
//! forecast are those of the [`crate::Mixture`].
//!
//! A measurement that is sharp relative to the cloud leaves few particles with any weight (degeneracy). The
//! cloud then represents a smooth density instead. Every particle becomes the centre of a Gaussian *kernel*,
//! shrunk towards the mean so that the cloud's moments remain. Kernels are updated like Kalman filters, and a
//! particle is drawn from each \[K. Dahia, C. Musso, D. Pham: *The Kalman-particle kernel filter*, 2005\].

use kinematics::semidefinite_cholesky;
use nalgebra::{SMatrix, SVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::moments::scatter;
use crate::plan::Plan;
use crate::process::steps;
use crate::weights::{effective_size, log_sum_exp, normalise, systematic};
use crate::{
    Controlled, FilterFault, Forecast, ForecastFault, Gaussian, Observation, Priors, difference, mean,
};

/// Kernels are widened up to this effective number. Width blurs, while more particles resolve more.
const EFFECTIVE_SIZE_ENOUGH: f64 = 250.0;
/// Factor on the covariance of the kernels from one width to the next.
const WIDENING: f64 = 1.5;
/// Largest number of particles in one filter.
pub const PARTICLES_MAX: usize = 10_000;

#[derive(Clone, Copy, Debug)]
struct Particle<const N: usize> {
    state: SVector<f64, N>,
    log_weight: f64,
    /// `None` for the kinematic process.
    hypothesis: Option<usize>,
}

/// The evidence of a cloud's kernels for an observation, and their common covariance after the update.
struct Kernels<const N: usize> {
    log_likelihood: f64,
    covariance: SMatrix<f64, N, N>,
}

/// A particle filter: bootstrap, with kernels if a measurement is too sharp.
#[derive(Clone, Debug)]
pub struct Particles<P, const N: usize> {
    /// Processes and trust. They may be changed between calls.
    pub priors: Priors<P>,
    particles: Vec<Particle<N>>,
    /// The particles of the next state. They replace the others once the step succeeds.
    next: Vec<Particle<N>>,
    /// Hypotheses drawn for the particles.
    drawn: Vec<Option<usize>>,
    plan: Plan,
    age_ns: u64,
    rng: ChaCha8Rng,
}

impl<P: Controlled<N>, const N: usize> Particles<P, N> {
    /// Particles drawn from a Gaussian.
    ///
    /// # Panics
    /// If `particle_count` is not within 1..=[`PARTICLES_MAX`].
    #[must_use]
    pub fn new(state: &Gaussian<N>, priors: Priors<P>, particle_count: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let states = (0..particle_count).map(|_| state.sample(|| StandardNormal.sample(&mut rng)));
        let states: Vec<_> = states.collect();
        Self { rng, ..Self::of(&states, priors, seed) }
    }

    /// Particles at the given states, of equal weight.
    ///
    /// # Panics
    /// If their number is not within 1..=[`PARTICLES_MAX`].
    #[must_use]
    pub fn of(states: &[SVector<f64, N>], priors: Priors<P>, seed: u64) -> Self {
        let len = states.len();
        assert!((1..=PARTICLES_MAX).contains(&len), "1..={PARTICLES_MAX} particles, not {len}");
        let log_weight = -(len as f64).ln();
        let particle = |&state: &SVector<f64, N>| Particle { state, log_weight, hypothesis: None };
        Self {
            priors,
            particles: states.iter().map(particle).collect(),
            next: Vec::with_capacity(len),
            drawn: Vec::with_capacity(len),
            plan: Plan::default(),
            age_ns: 0,
            rng: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// Adopts a forecast as the prior from now on. Every particle keeps its state and draws a hypothesis.
    ///
    /// # Errors
    /// [`ForecastFault`]; the particles are then unchanged.
    pub fn adopt(&mut self, forecast: &Forecast) -> Result<(), ForecastFault> {
        self.plan.adopt(forecast, &self.priors)?;
        self.age_ns = forecast.age_ns;
        let kinematic = self.priors.kinematic_weight;
        let sum: f64 = forecast.probability.iter().sum();
        let learned = forecast.probability.iter().map(|probability| (1.0 - kinematic) * probability / sum);
        let shares = std::iter::once(kinematic).chain(learned);
        self.drawn.clear();
        let drawn = systematic(shares, self.rng.random(), self.particles.len());
        self.drawn.extend(drawn.map(|number| number.checked_sub(1)));
        // Particles resampled from one particle are neighbours and must get different hypotheses.
        self.drawn.shuffle(&mut self.rng);
        for (particle, &hypothesis) in self.particles.iter_mut().zip(&self.drawn) {
            particle.hypothesis = hypothesis;
        }
        Ok(())
    }

    /// Predicts all particles `dt_ns` ahead. Beyond the forecast's horizon it uses the kinematic process
    /// alone.
    ///
    /// # Errors
    /// [`FilterFault`]; the particles are then unchanged.
    pub fn predict(&mut self, dt_ns: u64) -> Result<(), FilterFault> {
        let mut rng = self.rng.clone();
        let done = self.predict_with(dt_ns, || StandardNormal.sample(&mut rng));
        self.rng = rng;
        done
    }

    /// Like [`Particles::predict`], with given standard normal numbers. Each step uses one number per
    /// component, particle after particle.
    ///
    /// # Errors
    /// [`FilterFault`]; the particles are then unchanged.
    pub fn predict_with(&mut self, dt_ns: u64, mut normal: impl FnMut() -> f64) -> Result<(), FilterFault> {
        let age_ns = self.age_ns.saturating_add(dt_ns);
        let (step_count, dt_s) = steps(dt_ns)?;
        self.next.clone_from(&self.particles);
        for particle in &mut self.next {
            particle.hypothesis = particle.hypothesis.filter(|_| age_ns <= self.plan.horizon_ns);
        }
        for i in 0..step_count {
            let middle_ns = self.age_ns + dt_ns * (2 * i + 1) / (2 * step_count);
            for particle in &mut self.next {
                let from = Gaussian { mean: particle.state, covariance: SMatrix::zeros() };
                let (process, moved) = match particle.hypothesis {
                    None => (&self.priors.kinematic, self.priors.kinematic.step(&from, dt_s)),
                    Some(hypothesis) => {
                        let control = self.plan.at::<P, N>(hypothesis, middle_ns);
                        let process = self.priors.controlled(self.plan.gain(middle_ns));
                        (&self.priors.learned, process.step_controlled(&from, &control, dt_s))
                    }
                };
                particle.state = moved.sample(&mut normal);
                process.constrain(&mut particle.state);
            }
        }
        if !self.next.iter().all(|particle| particle.state.iter().all(|x| x.is_finite())) {
            return Err(FilterFault::NotFinite);
        }
        std::mem::swap(&mut self.particles, &mut self.next);
        self.age_ns = age_ns;
        Ok(())
    }

    /// Updates the particles by an observation. Returns the logarithm of its density.
    ///
    /// The observation weighs the particles. If the weights degenerate, the observation updates kernels
    /// instead, which are just wide enough to avoid degeneracy.
    ///
    /// # Errors
    /// Like [`Particles::weigh`].
    pub fn update(&mut self, observation: &Observation) -> Result<f64, FilterFault> {
        let log_likelihood = self.weighed(observation)?;
        if !is_degenerate(&self.next) {
            std::mem::swap(&mut self.particles, &mut self.next);
            return Ok(log_likelihood);
        }
        let mut share = kernel_share(self.effective_size(), N);
        let mut updated = self.updated_kernels(observation, share)?;
        let enough = EFFECTIVE_SIZE_ENOUGH.min(self.particles.len() as f64 / 2.0);
        while share < 1.0 && effective_size(weights(&self.next)) < enough {
            share = (WIDENING * share).min(1.0);
            updated = self.updated_kernels(observation, share)?;
        }
        std::mem::swap(&mut self.particles, &mut self.next);
        let centres = self.moments();
        let offset = self.rng.random();
        self.resample(offset);
        self.draw_from_kernels(&updated.covariance);
        self.match_moments(&Gaussian { covariance: centres.covariance + updated.covariance, ..centres });
        Ok(updated.log_likelihood)
    }

    /// Weighs the particles by an observation. Returns the logarithm of its density.
    ///
    /// # Errors
    /// [`FilterFault`] if no particle has a finite density; the particles are then unchanged.
    pub fn weigh(&mut self, observation: &Observation) -> Result<f64, FilterFault> {
        let log_likelihood = self.weighed(observation)?;
        std::mem::swap(&mut self.particles, &mut self.next);
        Ok(log_likelihood)
    }

    /// Writes the particles to `next`, weighed by an observation.
    fn weighed(&mut self, observation: &Observation) -> Result<f64, FilterFault> {
        self.next.clone_from(&self.particles);
        for particle in &mut self.next {
            let density = self.priors.kinematic.innovation(&particle.state, observation).log_density();
            if density.is_nan() {
                return Err(FilterFault::NotPositive);
            }
            particle.log_weight += density;
        }
        self.normalised()
    }

    /// Writes the kernels about the particles to `next`, updated by an observation. A kernel's covariance is
    /// the share `share` of the cloud's covariance.
    fn updated_kernels(&mut self, observation: &Observation, share: f64) -> Result<Kernels<N>, FilterFault> {
        let cloud = self.moments();
        let covariance = cloud.covariance * share;
        let shrinkage = (1.0 - share).sqrt();
        let mut kernels = Kernels { log_likelihood: 0.0, covariance };
        self.next.clear();
        for particle in &self.particles {
            let off = difference(&particle.state, &cloud.mean, P::ANGLES);
            let mut kernel = Gaussian { mean: cloud.mean + off * shrinkage, covariance };
            let innovation = self.priors.kinematic.innovation(&kernel.mean, observation);
            let evidence = kernel.correct(&innovation)?.evidence();
            kernels.covariance = kernel.covariance;
            let log_weight = particle.log_weight + evidence.log_likelihood;
            self.next.push(Particle { state: kernel.mean, log_weight, ..*particle });
        }
        kernels.log_likelihood = self.normalised()?;
        Ok(kernels)
    }

    /// Draws every particle from its kernel.
    fn draw_from_kernels(&mut self, covariance: &SMatrix<f64, N, N>) {
        let factor = semidefinite_cholesky(covariance);
        for particle in &mut self.particles {
            particle.state += factor * SVector::from_fn(|_, _| StandardNormal.sample(&mut self.rng));
        }
    }

    /// Shifts and scales the cloud so that it has exactly the moments of the density from which it was drawn
    /// \[J. Barraquand: *Numerical valuation of high dimensional multivariate European securities*, 1995\]. A
    /// cloud that is too small to have moments stays unchanged. States are constrained to their range.
    fn match_moments(&mut self, exact: &Gaussian<N>) {
        let cloud = self.moments();
        let root = cloud.covariance.cholesky();
        let factor = semidefinite_cholesky(&exact.covariance);
        for particle in &mut self.particles {
            let off = difference(&particle.state, &cloud.mean, P::ANGLES);
            if let Some(white) = root.and_then(|root| root.l_dirty().solve_lower_triangular(&off)) {
                particle.state = exact.mean + factor * white;
            }
            match particle.hypothesis {
                None => self.priors.kinematic.constrain(&mut particle.state),
                Some(_) => self.priors.learned.constrain(&mut particle.state),
            }
        }
    }

    /// Normalises the weights of `next` to the sum 1. Returns the logarithm of their previous sum.
    fn normalised(&mut self) -> Result<f64, FilterFault> {
        let log_sum = log_sum_exp(self.next.iter().map(|particle| particle.log_weight));
        if !log_sum.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        normalise(&mut self.next, |particle| &mut particle.log_weight);
        Ok(log_sum)
    }

    /// Effective sample size: the number of equally weighted particles that carry the same amount of
    /// information.
    pub fn effective_size(&self) -> f64 {
        effective_size(weights(&self.particles))
    }

    /// Whether the effective sample size is below half the number of particles.
    pub fn is_degenerate(&self) -> bool {
        is_degenerate(&self.particles)
    }

    /// Resamples the particles by their weights, systematically from `offset` within \[0, 1). All weights are
    /// then equal.
    pub fn resample(&mut self, offset: f64) {
        let Self { particles, next, .. } = self;
        let len = particles.len();
        let log_weight = -(len as f64).ln();
        next.clear();
        next.extend(
            systematic(weights(particles), offset, len).map(|i| Particle { log_weight, ..particles[i] }),
        );
        std::mem::swap(particles, next);
    }

    /// The particles with hypothesis, weight and state. The weights sum to 1.
    pub fn particles(&self) -> impl Iterator<Item = (Option<usize>, f64, &SVector<f64, N>)> {
        self.particles.iter().map(|p| (p.hypothesis, p.log_weight.exp(), &p.state))
    }

    /// The Gaussian with the particles' moments.
    pub fn moments(&self) -> Gaussian<N> {
        let points = || weights(&self.particles).zip(self.particles.iter().map(|particle| &particle.state));
        let mean = mean(points(), P::ANGLES);
        Gaussian { mean, covariance: scatter(points(), &mean, P::ANGLES) }
    }
}

fn weights<const N: usize>(particles: &[Particle<N>]) -> impl Iterator<Item = f64> + Clone {
    particles.iter().map(|particle| particle.log_weight.exp())
}

fn is_degenerate<const N: usize>(particles: &[Particle<N>]) -> bool {
    effective_size(weights(particles)) < particles.len() as f64 / 2.0
}

/// Share of a cloud's covariance that its kernels get. It is the square of the optimal bandwidth for a
/// Gaussian density with `len` draws in `dimensions` \[B. Silverman: *Density estimation*, 1986, §4.3\].
fn kernel_share(len: f64, dimensions: usize) -> f64 {
    let dimensions = dimensions as f64;
    (4.0 / ((dimensions + 2.0) * len)).powf(2.0 / (dimensions + 4.0)).min(1.0)
}
