//! The learned prior by Monte Carlo: a particle filter whose particles are steered by the draws of a forecast.
//!
//! Every particle is a state and the number of a hypothesis, or of none, which then moves by the kinematic process. It
//! draws its own noise, so nothing is linearised; the measurement weighs it by its density. The processes and the
//! forecast are those of the [`crate::Mixture`].
//!
//! A measurement that is sharp beside the cloud leaves few particles with any weight. The cloud then stands for a
//! smooth density instead: every particle is the centre of a Gaussian *kernel*, drawn in towards the mean so that the
//! cloud's moments stay. Kernels are corrected as Kalman filters are, and a particle is drawn from each \[K. Dahia,
//! C. Musso, D. Pham: *The Kalman-particle kernel filter*, 2005\].

use kinematics::semidefinite_cholesky;
use nalgebra::{SMatrix, SVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::control::Plan;
use crate::moments::scatter;
use crate::process::steps;
use crate::weights::{effective_size, log_sum_exp, normalise, systematic};
use crate::{FilterFault, Forecast, ForecastFault, Gaussian, Observation, Priors, Steered, difference, mean};

/// Kernels are widened no further than until so many of them count: width blurs, while more particles see more sharply.
const ENOUGH: f64 = 250.0;
/// From one width of the kernels to the next, as a factor on their covariance.
const WIDENING: f64 = 1.5;
/// Most particles of one filter.
pub const PARTICLES_MAX: usize = 10_000;

#[derive(Clone, Copy, Debug)]
struct Particle<const N: usize> {
    state: SVector<f64, N>,
    log_weight: f64,
    /// `None`: moves by the kinematic process.
    hypothesis: Option<usize>,
}

/// What a cloud's kernels told of an observation, and the covariance that they share after it.
struct Kernels<const N: usize> {
    log_likelihood: f64,
    covariance: SMatrix<f64, N, N>,
}

/// A particle filter: bootstrap, with kernels where a measurement is too sharp for that.
#[derive(Clone, Debug)]
pub struct Particles<P, const N: usize> {
    /// Processes and trust; may be changed between calls.
    pub priors: Priors<P>,
    particles: Vec<Particle<N>>,
    /// Particles under way; they replace the others when all is well.
    next: Vec<Particle<N>>,
    /// Hypotheses of the particles under way.
    drawn: Vec<Option<usize>>,
    plan: Plan,
    age_ns: u64,
    rng: ChaCha8Rng,
}

impl<P: Steered<N>, const N: usize> Particles<P, N> {
    /// Particles drawn from a Gaussian.
    ///
    /// # Panics
    /// If `particles_len` is not within 1..=[`PARTICLES_MAX`].
    #[must_use]
    pub fn new(state: &Gaussian<N>, priors: Priors<P>, particles_len: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let states = (0..particles_len).map(|_| state.sample(|| StandardNormal.sample(&mut rng)));
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

    /// Takes a forecast as the prior from now on: every particle keeps its state and is dealt a hypothesis.
    ///
    /// # Errors
    /// [`ForecastFault`]; the particles then go on as before.
    pub fn adopt(&mut self, forecast: &Forecast) -> Result<(), ForecastFault> {
        self.plan.adopt(forecast, &self.priors)?;
        self.age_ns = forecast.age_ns;
        let kinematic = self.priors.kinematic_weight;
        let sum: f64 = forecast.probability.iter().sum();
        let learned = forecast.probability.iter().map(|probability| (1.0 - kinematic) * probability / sum);
        let shares = std::iter::once(kinematic).chain(learned);
        self.drawn.clear();
        let dealt = systematic(shares, self.rng.random(), self.particles.len());
        self.drawn.extend(dealt.map(|number| number.checked_sub(1)));
        // Particles that were resampled from one stand side by side: they are to get different hypotheses.
        self.drawn.shuffle(&mut self.rng);
        for (particle, &hypothesis) in self.particles.iter_mut().zip(&self.drawn) {
            particle.hypothesis = hypothesis;
        }
        Ok(())
    }

    /// Moves all particles on by `dt_ns`; beyond the forecast's horizon the kinematic process alone does.
    ///
    /// # Errors
    /// [`FilterFault`]; the particles are then as before.
    pub fn predict(&mut self, dt_ns: u64) -> Result<(), FilterFault> {
        let mut rng = self.rng.clone();
        let done = self.predict_with(dt_ns, || StandardNormal.sample(&mut rng));
        self.rng = rng;
        done
    }

    /// As [`Particles::predict`], with standard normal numbers from elsewhere: one per component, particle after
    /// particle, in each step.
    ///
    /// # Errors
    /// [`FilterFault`]; the particles are then as before.
    pub fn predict_with(&mut self, dt_ns: u64, mut normal: impl FnMut() -> f64) -> Result<(), FilterFault> {
        let age_ns = self.age_ns.saturating_add(dt_ns);
        let (steps_len, dt_s) = steps(dt_ns)?;
        self.next.clone_from(&self.particles);
        for particle in &mut self.next {
            particle.hypothesis = particle.hypothesis.filter(|_| age_ns <= self.plan.horizon_ns);
        }
        for i in 0..steps_len {
            let middle_ns = self.age_ns + dt_ns * (2 * i + 1) / (2 * steps_len);
            for particle in &mut self.next {
                let from = Gaussian { mean: particle.state, covariance: SMatrix::zeros() };
                let (process, moved) = match particle.hypothesis {
                    None => (&self.priors.kinematic, self.priors.kinematic.step(&from, dt_s)),
                    Some(hypothesis) => {
                        let control = self.plan.at::<P, N>(hypothesis, middle_ns);
                        let process = self.priors.steered(self.plan.acting(middle_ns));
                        (&self.priors.learned, process.steer(&from, &control, dt_s))
                    }
                };
                particle.state = moved.sample(&mut normal);
                process.settle(&mut particle.state);
            }
        }
        if !self.next.iter().all(|particle| particle.state.iter().all(|x| x.is_finite())) {
            return Err(FilterFault::NotFinite);
        }
        std::mem::swap(&mut self.particles, &mut self.next);
        self.age_ns = age_ns;
        Ok(())
    }

    /// Corrects the particles by what was observed; returns the logarithm of the observation's density.
    ///
    /// They are weighed, or where few would then hold most of the weight corrected as kernels, just wide enough that more
    /// of them do.
    ///
    /// # Errors
    /// As [`Particles::weigh`].
    pub fn update(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        let log_likelihood = self.weighed(seen)?;
        if !is_poor(&self.next) {
            std::mem::swap(&mut self.particles, &mut self.next);
            return Ok(log_likelihood);
        }
        let mut share = kernel_share(self.effective_size(), N);
        let mut corrected = self.corrected(seen, share)?;
        let enough = ENOUGH.min(self.particles.len() as f64 / 2.0);
        while share < 1.0 && effective_size(weights(&self.next)) < enough {
            share = (WIDENING * share).min(1.0);
            corrected = self.corrected(seen, share)?;
        }
        std::mem::swap(&mut self.particles, &mut self.next);
        let centres = self.moments();
        let offset = self.rng.random();
        self.resample(offset);
        self.scatter(&corrected.covariance);
        self.stretch(&Gaussian { covariance: centres.covariance + corrected.covariance, ..centres });
        Ok(corrected.log_likelihood)
    }

    /// Weighs the particles by what was observed; returns the logarithm of the observation's density.
    ///
    /// # Errors
    /// [`FilterFault`] where no particle has a finite density; the particles are then as before.
    pub fn weigh(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        let log_likelihood = self.weighed(seen)?;
        std::mem::swap(&mut self.particles, &mut self.next);
        Ok(log_likelihood)
    }

    /// Makes the particles under way those of now, weighed by what was observed.
    fn weighed(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        self.next.clone_from(&self.particles);
        for particle in &mut self.next {
            let density = self.priors.kinematic.innovation(&particle.state, seen).log_density();
            if density.is_nan() {
                return Err(FilterFault::NotPositive);
            }
            particle.log_weight += density;
        }
        self.normalised()
    }

    /// Makes the particles under way the kernels about those of now, corrected by what was observed. A kernel's
    /// covariance is this share of the cloud's.
    fn corrected(&mut self, seen: &Observation, share: f64) -> Result<Kernels<N>, FilterFault> {
        let cloud = self.moments();
        let covariance = cloud.covariance * share;
        let drawn_in = (1.0 - share).sqrt();
        let mut kernels = Kernels { log_likelihood: 0.0, covariance };
        self.next.clear();
        for particle in &self.particles {
            let off = difference(&particle.state, &cloud.mean, P::ANGLES);
            let mut kernel = Gaussian { mean: cloud.mean + off * drawn_in, covariance };
            let innovation = self.priors.kinematic.innovation(&kernel.mean, seen);
            let evidence = kernel.correct(&innovation)?.evidence();
            kernels.covariance = kernel.covariance;
            let log_weight = particle.log_weight + evidence.log_likelihood;
            self.next.push(Particle { state: kernel.mean, log_weight, ..*particle });
        }
        kernels.log_likelihood = self.normalised()?;
        Ok(kernels)
    }

    /// Draws every particle from the kernel of which it is the centre.
    fn scatter(&mut self, covariance: &SMatrix<f64, N, N>) {
        let factor = semidefinite_cholesky(covariance);
        for particle in &mut self.particles {
            particle.state += factor * SVector::from_fn(|_, _| StandardNormal.sample(&mut self.rng));
        }
    }

    /// Moves and stretches the cloud a little so that it has exactly the moments of what it was drawn from
    /// \[J. Barraquand: *Numerical valuation of high dimensional multivariate European securities*, 1995\]; a cloud too
    /// small to have any stays. States come back into their range.
    fn stretch(&mut self, exact: &Gaussian<N>) {
        let cloud = self.moments();
        let root = cloud.covariance.cholesky();
        let stretched = semidefinite_cholesky(&exact.covariance);
        for particle in &mut self.particles {
            let off = difference(&particle.state, &cloud.mean, P::ANGLES);
            if let Some(white) = root.and_then(|root| root.l_dirty().solve_lower_triangular(&off)) {
                particle.state = exact.mean + stretched * white;
            }
            match particle.hypothesis {
                None => self.priors.kinematic.settle(&mut particle.state),
                Some(_) => self.priors.learned.settle(&mut particle.state),
            }
        }
    }

    /// Brings the weights of the particles under way to the sum 1; returns the logarithm of their sum before.
    fn normalised(&mut self) -> Result<f64, FilterFault> {
        let log_sum = log_sum_exp(self.next.iter().map(|particle| particle.log_weight));
        if !log_sum.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        normalise(&mut self.next, |particle| &mut particle.log_weight);
        Ok(log_sum)
    }

    /// How many equally heavy particles would say as much.
    #[must_use]
    pub fn effective_size(&self) -> f64 {
        effective_size(weights(&self.particles))
    }

    /// Whether the effective size is less than half the number of particles.
    #[must_use]
    pub fn is_poor(&self) -> bool {
        is_poor(&self.particles)
    }

    /// Chooses the particles anew by their weights, systematically from `offset` within \[0, 1); all then weigh the same.
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

    /// The particles: hypothesis, weight and state. The weights sum to 1.
    pub fn particles(&self) -> impl Iterator<Item = (Option<usize>, f64, &SVector<f64, N>)> {
        self.particles.iter().map(|p| (p.hypothesis, p.log_weight.exp(), &p.state))
    }

    /// The Gaussian with the particles' moments.
    #[must_use]
    pub fn moments(&self) -> Gaussian<N> {
        let points = || weights(&self.particles).zip(self.particles.iter().map(|particle| &particle.state));
        let mean = mean(points(), P::ANGLES);
        Gaussian { mean, covariance: scatter(points(), &mean, P::ANGLES) }
    }
}

fn weights<const N: usize>(particles: &[Particle<N>]) -> impl Iterator<Item = f64> + Clone {
    particles.iter().map(|particle| particle.log_weight.exp())
}

fn is_poor<const N: usize>(particles: &[Particle<N>]) -> bool {
    effective_size(weights(particles)) < particles.len() as f64 / 2.0
}

/// Share of a cloud's covariance that its kernels get: the square of the width that is best for a Gaussian density of
/// which `len` draws in `dimensions` are known \[B. Silverman: *Density estimation*, 1986, §4.3\].
fn kernel_share(len: f64, dimensions: usize) -> f64 {
    let dimensions = dimensions as f64;
    (4.0 / ((dimensions + 2.0) * len)).powf(2.0 / (dimensions + 4.0)).min(1.0)
}
