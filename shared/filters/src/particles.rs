//! The learned prior by Monte Carlo: a bootstrap particle filter whose particles are steered by the draws of a forecast.
//!
//! Every particle is a state and the number of a hypothesis, or of none, which then moves by the kinematic process. It
//! draws its own noise, so nothing is linearised; the measurement weighs it by its density. The processes and the
//! forecast are those of the [`crate::Mixture`].

use nalgebra::{SMatrix, SVector};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::control::Plan;
use crate::moments::scatter;
use crate::process::steps;
use crate::weights::{effective_size, log_sum_exp, normalise, systematic};
use crate::{FilterFault, Forecast, ForecastFault, Gaussian, Observation, Priors, Steered, mean};

/// Most particles of one filter.
pub const PARTICLES_MAX: usize = 10_000;

#[derive(Clone, Copy, Debug)]
struct Particle<const N: usize> {
    state: SVector<f64, N>,
    log_weight: f64,
    /// `None`: moves by the kinematic process.
    hypothesis: Option<usize>,
}

/// A bootstrap particle filter.
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
        self.plan.adopt(forecast, self.priors.covariance_scale)?;
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
                        (&self.priors.learned, self.priors.learned.steer(&from, &control, dt_s))
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

    /// Weighs the particles by what was observed, and resamples them where few hold most of the weight; returns the
    /// logarithm of the observation's density.
    ///
    /// # Errors
    /// As [`Particles::weigh`].
    pub fn update(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        let log_likelihood = self.weigh(seen)?;
        if self.is_poor() {
            let offset = self.rng.random();
            self.resample(offset);
        }
        Ok(log_likelihood)
    }

    /// Weighs the particles by what was observed; returns the logarithm of the observation's density.
    ///
    /// # Errors
    /// [`FilterFault`] where no particle has a finite density; the particles are then as before.
    pub fn weigh(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        self.next.clone_from(&self.particles);
        for particle in &mut self.next {
            let density = self.priors.kinematic.innovation(&particle.state, seen).log_density();
            if density.is_nan() {
                return Err(FilterFault::NotPositive);
            }
            particle.log_weight += density;
        }
        let log_likelihood = log_sum_exp(self.next.iter().map(|particle| particle.log_weight));
        if !log_likelihood.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        std::mem::swap(&mut self.particles, &mut self.next);
        normalise(&mut self.particles, |particle| &mut particle.log_weight);
        Ok(log_likelihood)
    }

    /// How many equally heavy particles would say as much.
    #[must_use]
    pub fn effective_size(&self) -> f64 {
        effective_size(self.weights())
    }

    /// Whether the effective size is less than half the number of particles.
    #[must_use]
    pub fn is_poor(&self) -> bool {
        self.effective_size() < self.particles.len() as f64 / 2.0
    }

    /// Chooses the particles anew by their weights, systematically from `offset` within \[0, 1); all then weigh the same.
    pub fn resample(&mut self, offset: f64) {
        let Self { particles, next, .. } = self;
        let len = particles.len();
        let log_weight = -(len as f64).ln();
        let weights = particles.iter().map(|particle| particle.log_weight.exp());
        next.clear();
        next.extend(systematic(weights, offset, len).map(|i| Particle { log_weight, ..particles[i] }));
        std::mem::swap(particles, next);
    }

    /// The particles: hypothesis, weight and state. The weights sum to 1.
    pub fn particles(&self) -> impl Iterator<Item = (Option<usize>, f64, &SVector<f64, N>)> {
        self.particles.iter().map(|p| (p.hypothesis, p.log_weight.exp(), &p.state))
    }

    /// The Gaussian with the particles' moments.
    #[must_use]
    pub fn moments(&self) -> Gaussian<N> {
        let points = || self.weights().zip(self.particles.iter().map(|particle| &particle.state));
        let mean = mean(points(), P::ANGLES);
        Gaussian { mean, covariance: scatter(points(), &mean, P::ANGLES) }
    }

    fn weights(&self) -> impl Iterator<Item = f64> + Clone {
        self.particles.iter().map(|particle| particle.log_weight.exp())
    }
}
