use filters::weights::systematic;
use filters::{
    Control, ControlStep, Controlled, FilterFault, Gaussian, Innovation, Observation, Particles, Priors,
    Process, STEP_MAX_NS,
};
use nalgebra::{Matrix2, Vector2};
use serde::Deserialize;

use super::ledger::{EXACT, Ledger};
use super::part::{Part, document};
use crate::VerifyError;

/// The only known model of `pf_small.json`, as the file names it.
const MODEL: &str =
    "x+=noise; z=x+N(0,.3^2 I); log w += -|x-z|^2/(2*.09); resample systematically iff ESS<N/2";

/// The model's variance of a measured position, per axis.
const POSITION_VARIANCE: f64 = 0.09;

/// `pf_small.json`: a bootstrap particle filter with all its random numbers.
#[derive(Deserialize)]
struct Reference {
    model: String,
    /// The particles at the start.
    x0: Vec<[f64; 2]>,
    /// The movement of each particle, per step.
    noise: Vec<Vec<[f64; 2]>>,
    /// The offset of the resampling, per step.
    u: Vec<f64>,
    /// The measured position, per step.
    z: Vec<[f64; 2]>,
    steps: Vec<Step>,
}

/// The results of a step.
#[derive(Deserialize)]
struct Step {
    /// Before the resampling, like all fields except `idx`.
    mean: [f64; 2],
    ess: f64,
    /// Without the constant of the Gaussian density.
    loglik_unnormalised: f64,
    resampled: bool,
    /// The particles that systematic resampling chooses.
    idx: Vec<usize>,
}

/// Moves by a standard normal step per axis. Its position is measured.
#[derive(Clone, Copy)]
struct RandomWalk;

impl Process<2> for RandomWalk {
    const ANGLES: &'static [usize] = &[];

    fn step(&self, state: &Gaussian<2>, _: f64) -> Gaussian<2> {
        Gaussian { mean: state.mean, covariance: state.covariance + Matrix2::identity() }
    }

    fn innovation(&self, mean: &Vector2<f64>, seen: &Observation) -> Innovation<2> {
        let [x, y] = seen.position_m;
        Innovation::of_position([x - mean.x, y - mean.y], seen.position_variance)
    }

    fn constrain(&self, _: &mut Vector2<f64>) {}
}

/// No control acts on the random walk.
impl Controlled<2> for RandomWalk {
    fn step_controlled(&self, state: &Gaussian<2>, _: &Control, dt_s: f64) -> Gaussian<2> {
        self.step(state, dt_s)
    }

    fn control(_: &[ControlStep], _: usize, _: f64, _: f64) -> Control {
        Control::default()
    }

    fn first_ns(step_ns: u64) -> u64 {
        step_ns
    }
}

pub(super) fn compare(part: &mut Part, ledger: &mut Ledger) -> Result<(), VerifyError> {
    let file = "pf_small.json";
    let Some(path) = part.find(file) else { return Ok(()) };
    let reference: Reference = document(&path)?;
    reference.check().map_err(|reason| VerifyError::malformed(&path, reason))?;
    let found =
        reference.run().map_err(|(k, fault)| VerifyError::caused(&path, &format!("step {k}"), fault))?;
    let steps = &reference.steps;
    let number = |of: fn(&Step) -> f64| steps.iter().map(of).collect::<Vec<_>>();
    let step_count = steps.len();
    let means: Vec<_> = steps.iter().flat_map(|step| step.mean).collect();
    ledger.compare(part.vector(file, "mean"), &[step_count, 2], &found.means, &means, &EXACT);
    let sizes = number(|step| step.ess);
    ledger.compare(part.vector(file, "ess"), &[step_count], &found.sizes, &sizes, &EXACT);
    let logs = number(|step| step.loglik_unnormalised);
    ledger.compare(part.vector(file, "loglik_unnormalised"), &[step_count], &found.logs, &logs, &EXACT);
    let resampled = number(|step| f64::from(u8::from(step.resampled)));
    ledger.compare(part.vector(file, "resampled"), &[step_count], &found.resampled, &resampled, &EXACT);
    let chosen: Vec<_> = steps.iter().flat_map(|step| &step.idx).map(|number| *number as f64).collect();
    let shape = [step_count, reference.x0.len()];
    ledger.compare(part.vector(file, "idx"), &shape, &found.chosen, &chosen, &EXACT);
    Ok(())
}

/// The results of our own particles, step by step.
#[derive(Default)]
struct Found {
    means: Vec<f64>,
    sizes: Vec<f64>,
    logs: Vec<f64>,
    /// 1 if the particles are resampled.
    resampled: Vec<f64>,
    chosen: Vec<f64>,
}

impl Reference {
    fn check(&self) -> Result<(), String> {
        let (particle_count, step_count) = (self.x0.len(), self.steps.len());
        if self.model != MODEL {
            return Err(format!("model \"{}\" is not \"{MODEL}\"", self.model));
        }
        if !(1..=filters::particles::PARTICLES_MAX).contains(&particle_count) {
            let most = filters::particles::PARTICLES_MAX;
            return Err(format!("x0 has {particle_count} particles, not 1 to {most}"));
        }
        let lens = [("noise", self.noise.len()), ("u", self.u.len()), ("z", self.z.len())];
        if let Some((name, len)) = lens.into_iter().find(|(_, len)| *len != step_count) {
            return Err(format!("{name} has {len} steps, steps has {step_count}"));
        }
        if let Some(k) = self.noise.iter().position(|noise| noise.len() != particle_count) {
            return Err(format!("noise of step {k} is not for {particle_count} particles"));
        }
        if let Some(k) = self.steps.iter().position(|step| step.idx.len() != particle_count) {
            return Err(format!("idx of step {k} is not for {particle_count} particles"));
        }
        match self.u.iter().position(|u| !(0.0..1.0).contains(u)) {
            Some(k) => Err(format!("u of step {k} is {}, not within [0, 1)", self.u[k])),
            None => Ok(()),
        }
    }

    /// Runs the filter. A fault is returned with the number of its step.
    fn run(&self) -> Result<Found, (usize, FilterFault)> {
        let states: Vec<_> = self.x0.iter().map(|state| Vector2::from(*state)).collect();
        let mut particles = Particles::of(&states, Priors::new(RandomWalk, RandomWalk), 0);
        let mut found = Found::default();
        let constant = (std::f64::consts::TAU * POSITION_VARIANCE).ln();
        for (k, noise) in self.noise.iter().enumerate() {
            // The lengths were checked: there is one number per axis and particle.
            let mut normals = noise.as_flattened().iter().copied();
            let moved = particles.predict_with(STEP_MAX_NS, || normals.next().unwrap_or(f64::NAN));
            moved.map_err(|fault| (k, fault))?;
            let seen = Observation::of_position(self.z[k], POSITION_VARIANCE);
            let log = particles.weigh(&seen).map_err(|fault| (k, fault))?;
            found.logs.push(log + constant);
            found.means.extend(particles.moments().mean.iter());
            found.sizes.push(particles.effective_size());
            let weights = particles.particles().map(|(_, weight, _)| weight);
            found.chosen.extend(systematic(weights, self.u[k], states.len()).map(|number| number as f64));
            found.resampled.push(f64::from(u8::from(particles.is_degenerate())));
            if particles.is_degenerate() {
                particles.resample(self.u[k]);
            }
        }
        Ok(found)
    }
}
