use filters::{
    Ahead, Bicycle, ConstantVelocity, Filter, FilterFault, Forecast, ForecastFault, Gaussian, Integrator,
    Kind, Mixture, Models, Motion, Observation, Priors, Unknown, control_gain, noise_left, reversed,
};
use wire::{MODES_MAX, Steering};

use crate::options::ForecastTrust;

/// The belief about an agent's motion: one Gaussian. While a forecast is the prior, the Gaussian has the
/// moments of a mixture of hypotheses.
#[derive(Debug)]
pub struct Belief {
    filter: Filter,
    hypotheses: Option<Hypotheses>,
}

/// One filter for each mode of a forecast and one without, by the kind of the controls.
#[derive(Clone, Debug)]
enum Hypotheses {
    Bicycle(Box<Mixture<Bicycle, 5>>),
    Displacement(Box<Mixture<ConstantVelocity, 4>>),
}

impl Belief {
    /// A belief without a forecast.
    #[must_use]
    pub const fn new(filter: Filter) -> Self {
        Self { filter, hypotheses: None }
    }

    /// The belief as one Gaussian.
    #[must_use]
    pub const fn filter(&self) -> &Filter {
        &self.filter
    }

    /// Predicts the belief `dt_ns` ahead. Beyond the forecast's horizon it uses the process model alone.
    ///
    /// # Errors
    /// [`FilterFault`]; the belief is then unchanged.
    pub fn predict(&mut self, dt_ns: u64, models: &Models, trust: &ForecastTrust) -> Result<(), FilterFault> {
        match &mut self.hypotheses {
            None => return self.filter.predict(dt_ns, models),
            Some(Hypotheses::Bicycle(mixture)) => {
                mixture.priors = trust.bicycle(models, mixture.priors.control_gain);
                mixture.predict(dt_ns)?;
            }
            Some(Hypotheses::Displacement(mixture)) => {
                mixture.priors = trust.displacement(models);
                mixture.predict(dt_ns)?;
            }
        }
        self.match_moments();
        Ok(())
    }

    /// Updates the belief and the weights of the hypotheses by several observations. At most one of them is
    /// an observation of the agent; each comes with the probability that it is.
    ///
    /// # Errors
    /// [`FilterFault`]; the belief is then unchanged.
    pub fn update(&mut self, possible: &[(f64, Observation)], models: &Models) -> Result<(), FilterFault> {
        match &mut self.hypotheses {
            None => return self.filter.update_jointly(possible, models),
            Some(Hypotheses::Bicycle(mixture)) => mixture.update_jointly(possible)?,
            Some(Hypotheses::Displacement(mixture)) => mixture.update_jointly(possible)?,
        }
        self.match_moments();
        Ok(())
    }

    /// Like [`Belief::update`], by observations made `lag_s` after the belief's time (before it if `lag_s` is
    /// negative). The belief is shifted to the observations and back without process noise.
    ///
    /// # Errors
    /// [`FilterFault`]; the belief is then unchanged.
    pub fn update_at(
        &mut self,
        lag_s: f64,
        possible: &[(f64, Observation)],
        models: &Models,
    ) -> Result<(), FilterFault> {
        if lag_s == 0.0 {
            return self.update(possible, models);
        }
        self.shift(lag_s, models);
        let outcome = self.update(possible, models);
        self.shift(-lag_s, models);
        outcome
    }

    /// Moves the belief `dt_s` ahead (back if `dt_s` is negative) without process noise.
    pub fn shift(&mut self, dt_s: f64, models: &Models) {
        match &mut self.hypotheses {
            None => self.filter = self.filter.shifted(dt_s, models),
            Some(Hypotheses::Bicycle(mixture)) => mixture.shift(dt_s, &models.bicycle.noiseless()),
            Some(Hypotheses::Displacement(mixture)) => {
                mixture.shift(dt_s, &models.constant_velocity.noiseless());
            }
        }
        self.match_moments();
    }

    /// Limits the speed of the motion to `most_mps`. If the motion is faster, this drops the forecast that
    /// led there.
    pub fn limit_speed(&mut self, most_mps: f64) {
        let speed_mps = self.motion().speed_mps.abs();
        if speed_mps > most_mps {
            // Slightly below the limit, so that the coarser numbers in a payload do not exceed it.
            *self = Self::new(self.filter.slowed(most_mps / speed_mps * (1.0 - 1e-6)));
        }
    }

    /// Whether a forecast with this kind of control can predict the state.
    #[must_use]
    pub const fn accepts(&self, steering: Steering) -> bool {
        matches!(
            (steering, &self.filter),
            (Steering::Bicycle, Filter::Bicycle(_)) | (Steering::Displacement, Filter::ConstantVelocity(_))
        )
    }

    /// Adopts a forecast as the prior from now on, if the belief [accepts](Belief::accepts) it.
    ///
    /// # Errors
    /// [`ForecastFault`]; the belief is then unchanged.
    pub fn adopt(
        &mut self,
        forecast: &Forecast<'_>,
        (models, trust): (&Models, &ForecastTrust),
        seed: u64,
    ) -> Result<(), ForecastFault> {
        let (adopted, hypotheses) = match (&self.filter, self.hypotheses.take()) {
            (Filter::Bicycle(state), Some(Hypotheses::Bicycle(mut mixture))) => {
                let before = mixture.priors;
                mixture.priors = trust.bicycle(models, trust.control_gain(state));
                let adopted = mixture.adopt(forecast).inspect_err(|_| mixture.priors = before);
                (adopted, Hypotheses::Bicycle(mixture))
            }
            (Filter::Bicycle(state), _) => {
                let mut mixture =
                    Mixture::new(*state, trust.bicycle(models, trust.control_gain(state)), seed);
                (mixture.adopt(forecast), Hypotheses::Bicycle(Box::new(mixture)))
            }
            (Filter::ConstantVelocity(_), Some(Hypotheses::Displacement(mut mixture))) => {
                let before = mixture.priors;
                mixture.priors = trust.displacement(models);
                let adopted = mixture.adopt(forecast).inspect_err(|_| mixture.priors = before);
                (adopted, Hypotheses::Displacement(mixture))
            }
            (Filter::ConstantVelocity(state), _) => {
                let mut mixture = Mixture::new(*state, trust.displacement(models), seed);
                (mixture.adopt(forecast), Hypotheses::Displacement(Box::new(mixture)))
            }
        };
        self.hypotheses = Some(hypotheses);
        self.match_moments();
        adopted
    }

    /// Converts the motion to the state of another kind and drops the forecast.
    pub fn convert_to(&mut self, kind: Kind, unknown: &Unknown) {
        *self = Self::new(self.filter.into_kind(kind, unknown));
    }

    /// Exchanges front and back. This drops the forecast, which is relative to the old front.
    pub fn reverse(&mut self) {
        if let Filter::Bicycle(state) = &self.filter {
            *self = Self::new(Filter::Bicycle(reversed(state)));
        }
    }

    /// Drops the forecast: the process model alone is the prior from now on.
    pub fn drop_forecast(&mut self) {
        self.hypotheses = None;
    }

    /// Mean position and its covariance as (xx, xy, yy).
    #[must_use]
    pub fn position(&self) -> ([f64; 2], [f64; 3]) {
        self.filter.position()
    }

    /// The motion of the mean.
    #[must_use]
    pub fn motion(&self) -> Motion {
        self.filter.motion()
    }

    /// Time since the start of the forecast that is the prior.
    #[must_use]
    pub fn forecast_age_ns(&self) -> Option<u64> {
        self.hypotheses.as_ref().and_then(Hypotheses::forecast_age_ns)
    }

    /// The positions of the agent after one to `PARTS` times `part_ns`, by its forecast and by the process
    /// model alone. Returns `None` if there is no forecast or its horizon is too short.
    #[must_use]
    pub fn ahead<const PARTS: usize>(&self, part_ns: u64) -> Option<[Ahead; PARTS]> {
        match self.hypotheses.as_ref()? {
            Hypotheses::Bicycle(mixture) => mixture.ahead(part_ns),
            Hypotheses::Displacement(mixture) => mixture.ahead(part_ns),
        }
    }

    /// Weights of the forecast's modes, followed by the weight of the process model alone.
    #[must_use]
    pub fn weights(&self) -> [f32; MODES_MAX + 1] {
        let mut weights = [0.0; MODES_MAX + 1];
        let mut add = |mode: Option<usize>, weight: f64| {
            weights[mode.unwrap_or(MODES_MAX).min(MODES_MAX)] += weight as f32;
        };
        match &self.hypotheses {
            None => add(None, 1.0),
            Some(Hypotheses::Bicycle(mixture)) => mixture.components().for_each(|(k, w, _)| add(k, w)),
            Some(Hypotheses::Displacement(mixture)) => mixture.components().for_each(|(k, w, _)| add(k, w)),
        }
        weights
    }

    /// Matches the Gaussian to the moments of the hypotheses. Drops the hypotheses of an expired forecast.
    fn match_moments(&mut self) {
        let Some(hypotheses) = &self.hypotheses else { return };
        self.filter = match hypotheses {
            Hypotheses::Bicycle(mixture) => Filter::Bicycle(mixture.moments()),
            Hypotheses::Displacement(mixture) => Filter::ConstantVelocity(mixture.moments()),
        };
        if hypotheses.forecast_age_ns().is_none() {
            self.hypotheses = None;
        }
    }
}

impl Clone for Belief {
    fn clone(&self) -> Self {
        Self { filter: self.filter, hypotheses: self.hypotheses.clone() }
    }

    /// Reuses the memory of hypotheses of the same kind.
    fn clone_from(&mut self, source: &Self) {
        self.filter = source.filter;
        match (&mut self.hypotheses, &source.hypotheses) {
            (Some(Hypotheses::Bicycle(own)), Some(Hypotheses::Bicycle(source))) => own.clone_from(source),
            (Some(Hypotheses::Displacement(own)), Some(Hypotheses::Displacement(source))) => {
                own.clone_from(source);
            }
            (own, source) => own.clone_from(source),
        }
    }
}

impl Hypotheses {
    /// Time since the start of the forecast; `None` once the forecast has expired.
    fn forecast_age_ns(&self) -> Option<u64> {
        match self {
            Self::Bicycle(mixture) => mixture.forecast_age_ns(),
            Self::Displacement(mixture) => mixture.forecast_age_ns(),
        }
    }
}

impl ForecastTrust {
    /// Gains of the controls acceleration and slip rate. They depend on how well a vehicle's speed and
    /// heading are known.
    ///
    /// The network infers the slip from past turns of the heading. The filter weighs every position by its
    /// noise, so it never had the slip that noise put there. A control that removes this slip would be an
    /// error.
    fn control_gain(&self, state: &Gaussian<5>) -> [f64; 2] {
        let gain = |component: usize, half_gain_sigma: f64| {
            control_gain(half_gain_sigma, state.covariance[(component, component)])
        };
        [gain(3, self.half_gain_speed_mps), gain(2, self.half_gain_heading_rad)]
    }

    /// The part of a control that the gain leaves out stays with the process model, with its noise and the
    /// decay of its slip. At gain 0 a mode is the process model. At gain 1 the slip rate alone determines how
    /// a turn continues and ends.
    fn bicycle(&self, models: &Models, control_gain: [f64; 2]) -> Priors<Bicycle> {
        let kinematic = models.bicycle;
        let [of_acceleration, of_slip_rate] = control_gain.map(|gain| noise_left(gain, self.noise_share));
        let learned = Bicycle {
            // The integrator for which the controls were learned. Euler steps lag behind under an
            // acceleration.
            integrator: Integrator::Midpoint,
            acceleration_mps2: of_acceleration * kinematic.acceleration_mps2,
            slip_rate_radps: of_slip_rate * kinematic.slip_rate_radps,
            slip_decay_per_s: (1.0 - control_gain[1]) * kinematic.slip_decay_per_s,
            ..kinematic
        };
        Priors { control_gain, ..self.priors(kinematic, learned) }
    }

    fn displacement(&self, models: &Models) -> Priors<ConstantVelocity> {
        let kinematic = models.constant_velocity;
        let learned = ConstantVelocity { density: self.noise_share.powi(2) * kinematic.density };
        self.priors(kinematic, learned)
    }

    fn priors<P: Copy>(&self, kinematic: P, learned: P) -> Priors<P> {
        Priors {
            kinematic_weight: self.kinematic_weight,
            covariance_scale: self.covariance_scale,
            ..Priors::new(kinematic, learned)
        }
    }
}

#[cfg(test)]
mod tests {
    use filters::{ControlStep, Filter, Forecast, Gaussian};
    use wire::{AgentType, MODES_MAX};

    use super::Belief;
    use crate::TrackerOptions;
    use crate::options::ForecastTrust;

    /// The weight that trials give the process model holds for the first forecast and for each later one, for
    /// both kinds of controls.
    #[test]
    fn each_forecast_is_adopted_with_the_trust_of_its_time() {
        let input = TrackerOptions::default().detector;
        let step = ControlStep { mean: [0.0; 2], cholesky: [0.3, 0.0, 0.3] };
        let controls = [step; 4];
        let forecast = Forecast {
            age_ns: 0,
            step_ns: 400_000_000,
            heading_rad: 0.0,
            probability: &[1.0],
            controls: &controls,
        };
        let displacement = Filter::ConstantVelocity(Gaussian::new([0.0, 0.0, 1.0, 0.0], [0.1; 4]));
        let bicycle = Filter::Bicycle(Gaussian::new([0.0, 0.0, 0.0, 1.0, 0.0], [0.1; 5]));
        for (filter, agent_type) in [(displacement, AgentType::Pedestrian), (bicycle, AgentType::Vehicle)] {
            let models = input.models(agent_type, 0.0);
            let mut belief = Belief::new(filter);
            for kinematic_weight in [0.25, 0.75, 0.5] {
                let trust = ForecastTrust { kinematic_weight, ..input.trust[agent_type.index()] };
                belief.adopt(&forecast, (&models, &trust), 1).expect("possible numbers");
                let found = belief.weights()[MODES_MAX];
                assert!((f64::from(found) - kinematic_weight).abs() < 1e-6, "{agent_type:?}: {found}");
                belief
                    .predict(80_000_000, &models, &input.trust[agent_type.index()])
                    .expect("a finite state");
            }
        }
    }

    /// A slip rate at gain 1 determines the slip, so the slip must not also decay.
    #[test]
    fn slip_decay_is_what_the_control_gain_leaves() {
        let input = TrackerOptions::default().detector;
        let models = input.models(AgentType::Vehicle, 4.5);
        let decay_per_s = models.bicycle.slip_decay_per_s;
        assert!(decay_per_s > 0.0);
        for (gain, left) in [(0.0, 1.0), (0.25, 0.75), (1.0, 0.0)] {
            let priors = input.trust[0].bicycle(&models, [1.0, gain]);
            assert_eq!(priors.kinematic.slip_decay_per_s, decay_per_s);
            assert_eq!(priors.learned.slip_decay_per_s, left * decay_per_s, "a gain of {gain}");
        }
    }
}
