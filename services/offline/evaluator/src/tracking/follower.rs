//! Runs one filter per agent over a course.

use std::collections::BTreeMap;

use filters::{
    ConstantAcceleration, Filter, Forecast, Gaussian, Kind, Mixture, Observation, Particles, Unknown,
};
use metrics::tracking::{PlanarState, normalised_square};
use nalgebra::{Matrix2, Vector4};
use scene::State;
use wire::AgentType;

use super::{
    ACCELERATION_MPS2, Course, Error, Estimate, Hypotheses, Instant, OnboardForecasts, Outcome, SETTLED_S,
    Seen, Settings, SingerBicycle, TURN_RATE_RADPS, TrackingMethod, UNKNOWN, control_gains, smooth,
};
use crate::forecaster::Forecaster;

/// Maximum standard deviation of a known course. States with a heading also need [`COURSE_KNOWN_MPS`].
const COURSE_KNOWN_RAD: f64 = 0.3;
/// Minimum speed of a known course.
const COURSE_KNOWN_MPS: f64 = 0.5;
/// Particles per vehicle.
const PARTICLES: usize = 200;
/// Runs a method over courses.
pub(crate) struct Follower<'a> {
    pub(crate) method: TrackingMethod,
    pub(crate) settings: Settings,
    /// Forecasts for the learned prior.
    pub(crate) forecaster: &'a Forecaster,
}

/// The state estimate of one agent.
enum Estimator {
    Filter(Box<Filter>),
    Acceleration(Box<Gaussian<6>>),
    TurnRate(Box<Gaussian<5>>),
    /// A mixture with one component if there is no forecast.
    Mixture(Box<Mixture<SingerBicycle, 7>>),
    Particles(Box<Particles<SingerBicycle, 7>>),
}

struct Track {
    agent_type: AgentType,
    length_m: Option<f32>,
    born_ns: i64,
    estimator: Estimator,
    /// Last known heading, for states without a heading.
    heading_rad: f64,
    /// Whether the vehicle was measured since its last forecast. Otherwise a new forecast adds no
    /// information.
    is_fresh: bool,
}

impl Follower<'_> {
    /// Follows all agents of a course. Only the errors of vehicles count.
    pub(crate) fn follow(&self, course: &Course) -> Outcome {
        if self.method == TrackingMethod::Smoother {
            let [jerk_density, ..] = self.settings.of(self.method.tuned_as());
            return smooth(course, jerk_density);
        }
        let mut outcome = Outcome::default();
        let mut tracks: BTreeMap<u64, Track> = BTreeMap::new();
        let mut forecasts = OnboardForecasts::new(self.forecaster, course.place, self.method.retrieves());
        let step_ns = self.forecaster.config().step_ns().cast_signed();
        let mut next_ns = course.instants.first().map_or(0, |first| first.stamp_ns);
        let mut last_ns = None;
        for (instant, tick) in course.instants.iter().zip(0..) {
            let elapsed_ns = last_ns.map_or(0, |last: i64| instant.stamp_ns - last).cast_unsigned();
            last_ns = Some(instant.stamp_ns);
            self.advance((tick, instant), elapsed_ns, course.sensor.sigma_m, &mut tracks, &mut outcome);
            // One forecast per step of the model, so that modes exist long enough for measurements to
            // distinguish them.
            if self.method.is_learned() && instant.stamp_ns >= next_ns {
                next_ns += step_ns;
                self.adopt(&mut forecasts, instant, &mut tracks);
            }
        }
        outcome
    }

    /// Predicts and updates all tracks and records their errors.
    fn advance(
        &self,
        (tick, instant): (u64, &Instant),
        elapsed_ns: u64,
        sigma_m: f64,
        tracks: &mut BTreeMap<u64, Track>,
        outcome: &mut Outcome,
    ) {
        tracks.retain(|id, _| instant.agents.binary_search_by_key(id, |seen| seen.id).is_ok());
        for seen in &instant.agents {
            let observation =
                seen.measured_m.map(|position_m| Observation::of_position(position_m, sigma_m * sigma_m));
            let Some(track) = tracks.get_mut(&seen.id) else {
                let started = observation.map(|first| Track::start(seen, instant.stamp_ns, &first));
                tracks.extend(started.map(|track| (seen.id, track)));
                continue;
            };
            let counts = seen.agent_type == AgentType::Vehicle;
            let mut fault_count = u64::from(track.predict(elapsed_ns, &self.settings).is_none());
            if let Some(observation) = observation {
                track.is_fresh = true;
                match track.update(&observation, &self.settings) {
                    Some((nis, log_likelihood)) if counts => {
                        outcome.add_innovation(tick, nis, log_likelihood);
                    }
                    Some(_) => {}
                    None => fault_count += 1,
                }
            }
            track.initialise(self.method, &self.settings, seen.id);
            outcome.fault_count += fault_count;
            let age_s = (instant.stamp_ns - track.born_ns) as f64 / 1e9;
            if let Some(truth) = seen.truth.filter(|_| counts && age_s >= SETTLED_S) {
                let (error, nees) = track.error(seen, instant.stamp_ns, truth);
                outcome.add_estimate(tick, error, nees);
            }
        }
    }

    /// Forecasts all agents from their estimates. The forecasts become the vehicles' priors.
    fn adopt(&self, forecasts: &mut OnboardForecasts, instant: &Instant, tracks: &mut BTreeMap<u64, Track>) {
        let estimates: Vec<Estimate> = tracks
            .iter_mut()
            .map(|(&id, track)| Estimate {
                id,
                agent_type: track.agent_type,
                length_m: track.length_m,
                state: track.state(),
                is_measured: instant.measures(id),
                wanted: track.is_fresh
                    && matches!(track.estimator, Estimator::Mixture(_) | Estimator::Particles(_)),
            })
            .collect();
        let step_ns = self.forecaster.config().step_ns();
        for (id, hypotheses) in forecasts.forecast(instant.stamp_ns, instant.ego_m, &estimates) {
            let Some(track) = tracks.get_mut(&id) else { continue };
            let Hypotheses { heading_rad, probability, controls } = hypotheses;
            let forecast =
                Forecast { age_ns: 0, step_ns, heading_rad, probability: &probability, controls: &controls };
            let priors = |state| self.settings.priors(self.method, track.length_m, control_gains(state));
            let adopted = match &mut track.estimator {
                Estimator::Filter(_) | Estimator::Acceleration(_) | Estimator::TurnRate(_) => Ok(()),
                Estimator::Mixture(mixture) => {
                    mixture.priors = priors(&mixture.moments());
                    mixture.adopt(&forecast)
                }
                Estimator::Particles(particles) => {
                    particles.priors = priors(&particles.moments());
                    particles.adopt(&forecast)
                }
            };
            // If a forecast can't be used, the previous one remains.
            track.is_fresh = adopted.is_err();
        }
    }
}

impl Track {
    fn start(seen: &Seen, stamp_ns: i64, first: &Observation) -> Self {
        let filter = Filter::start(Kind::ConstantVelocity, first, &UNKNOWN);
        Self {
            agent_type: seen.agent_type,
            length_m: seen.length_m,
            born_ns: stamp_ns,
            estimator: Estimator::Filter(Box::new(filter)),
            heading_rad: 0.0,
            is_fresh: true,
        }
    }

    fn predict(&mut self, elapsed_ns: u64, settings: &Settings) -> Option<()> {
        match &mut self.estimator {
            Estimator::Filter(filter) => filter.predict(elapsed_ns, &settings.models(self.length_m)).ok(),
            Estimator::Acceleration(state) => state.predict(elapsed_ns, &settings.acceleration()).ok(),
            Estimator::TurnRate(state) => state.predict(elapsed_ns, &settings.turn_rate()).ok(),
            Estimator::Mixture(mixture) => mixture.predict(elapsed_ns).ok(),
            Estimator::Particles(particles) => particles.predict(elapsed_ns).ok(),
        }
    }

    /// Normalised squared innovation and log-likelihood.
    fn update(&mut self, seen: &Observation, settings: &Settings) -> Option<(f64, f64)> {
        let evidence = match &mut self.estimator {
            Estimator::Filter(filter) => filter.update(seen, &settings.models(self.length_m)),
            Estimator::Acceleration(state) => state.update(seen, &settings.acceleration()),
            Estimator::TurnRate(state) => state.update(seen, &settings.turn_rate()),
            Estimator::Mixture(mixture) => {
                let nis = innovation_squared(&mixture.moments(), seen)?;
                return Some((nis, mixture.update(seen).ok()?));
            }
            Estimator::Particles(particles) => {
                let nis = innovation_squared(&particles.moments(), seen)?;
                return Some((nis, particles.update(seen).ok()?));
            }
        };
        evidence.ok().map(|evidence| (evidence.nis, evidence.log_likelihood))
    }

    /// Switches to the method's state once the motion determines a heading.
    fn initialise(&mut self, method: TrackingMethod, settings: &Settings, id: u64) {
        let Estimator::Filter(filter) = &self.estimator else { return };
        let is_ready = match method {
            TrackingMethod::ConstantVelocity => false,
            TrackingMethod::ConstantAcceleration | TrackingMethod::Smoother => true,
            _ => filter.motion().speed_mps > COURSE_KNOWN_MPS && filter.course_sigma_rad() < COURSE_KNOWN_RAD,
        };
        if self.agent_type != AgentType::Vehicle || filter.kind() == Kind::Bicycle || !is_ready {
            return;
        }
        let polar = |last_sigma: f64| match filter
            .into_kind(Kind::Bicycle, &Unknown { slip_rad: last_sigma, ..UNKNOWN })
        {
            Filter::Bicycle(state) => state,
            Filter::ConstantVelocity(_) => unreachable!("the filter was converted to a bicycle"),
        };
        let priors = settings.priors(method, self.length_m, [1.0; 2]);
        self.estimator = match method {
            TrackingMethod::ConstantVelocity
            | TrackingMethod::ConstantAcceleration
            | TrackingMethod::Smoother => Estimator::Acceleration(Box::new(ConstantAcceleration::of(
                &filter.cartesian(),
                ACCELERATION_MPS2,
            ))),
            TrackingMethod::ConstantTurnRate => Estimator::TurnRate(Box::new(polar(TURN_RATE_RADPS))),
            TrackingMethod::Bicycle => Estimator::Filter(Box::new(Filter::Bicycle(polar(UNKNOWN.slip_rad)))),
            TrackingMethod::LearnedParticles => {
                let start = priors.kinematic.of(&polar(UNKNOWN.slip_rad));
                Estimator::Particles(Box::new(Particles::new(&start, priors, PARTICLES, id)))
            }
            TrackingMethod::SingerBicycle | TrackingMethod::Learned | TrackingMethod::WarmStarted => {
                let start = priors.kinematic.of(&polar(UNKNOWN.slip_rad));
                Estimator::Mixture(Box::new(Mixture::new(start, priors, id)))
            }
        };
    }

    fn filter(&self) -> Filter {
        match &self.estimator {
            Estimator::Filter(filter) => **filter,
            Estimator::Acceleration(state) => {
                Filter::ConstantVelocity(ConstantAcceleration::cartesian(state))
            }
            // The motion of a bicycle without slip.
            Estimator::TurnRate(state) => {
                let mut state = **state;
                state.mean[4] = 0.0;
                state.covariance.row_mut(4).fill(0.0);
                state.covariance.column_mut(4).fill(0.0);
                Filter::Bicycle(state)
            }
            Estimator::Mixture(mixture) => Filter::Bicycle(SingerBicycle::bicycle_of(&mixture.moments())),
            Estimator::Particles(particles) => {
                Filter::Bicycle(SingerBicycle::bicycle_of(&particles.moments()))
            }
        }
    }

    /// The state that the model receives.
    fn state(&mut self) -> State {
        let motion = self.filter().motion();
        let [vx, vy] = motion.velocity_mps;
        let course = (vx.hypot(vy) > COURSE_KNOWN_MPS).then(|| vy.atan2(vx));
        self.heading_rad = motion.heading_rad.or(course).unwrap_or(self.heading_rad);
        State {
            position_m: motion.position_m.map(|value| value as f32),
            velocity_mps: motion.velocity_mps.map(|value| value as f32),
            heading_rad: self.heading_rad as f32,
        }
    }

    fn error(&self, seen: &Seen, stamp_ns: i64, truth: PlanarState) -> (Error, Option<f64>) {
        let state = self.filter().cartesian();
        let [[x, y], [vx, vy]] = [truth.position_m, truth.velocity_mps];
        let error = state.mean - Vector4::new(x, y, vx, vy);
        let nees = normalised_square(
            &error.fixed_rows::<2>(0).into_owned(),
            &state.covariance.fixed_view::<2, 2>(0, 0).into_owned(),
        );
        let [x, y, vx, vy] = state.mean.into();
        let estimate = PlanarState { position_m: [x, y], velocity_mps: [vx, vy] };
        (Error::of(seen, stamp_ns, truth, estimate), nees)
    }
}

/// Normalised squared innovation.
fn innovation_squared(predicted: &Gaussian<7>, seen: &Observation) -> Option<f64> {
    let innovation = [0, 1].map(|axis| seen.position_m[axis] - predicted.mean[axis]);
    let noise = Matrix2::from_diagonal_element(seen.position_variance);
    normalised_square(&innovation.into(), &(predicted.covariance.fixed_view::<2, 2>(0, 0) + noise))
}

#[cfg(test)]
mod tests {
    use super::super::course::tests::{corner, recording};
    use super::super::{Place, Sensor};
    use super::*;
    use crate::forecaster::MapInput;
    use crate::scenes::Cut;

    const SENSOR: Sensor = Sensor { sigma_m: 0.1, gap_s: 1.6, seed: 1 };

    fn follow(method: TrackingMethod) -> Outcome {
        follow_until(i64::MAX, method)
    }

    fn follow_until(end_ns: i64, method: TrackingMethod) -> Outcome {
        let forecaster = Forecaster::new(nn::Weights::onboard(), 1).unwrap();
        let settings = Settings::first().with(TrackingMethod::ConstantVelocity, [0.01, 1.0, 1.0]);
        let place = Place { map: MapInput::Online, memory: Some(forecaster.memory()) };
        let course = Course::new(&recording(), [0, end_ns], SENSOR, &place);
        Follower { method, settings, forecaster: &forecaster }.follow(&course)
    }

    #[test]
    fn a_filter_with_the_right_model_beats_the_sensor_and_is_consistent() {
        let outcome = follow(TrackingMethod::ConstantVelocity);
        let visible = || outcome.errors.iter().filter(|error| error.visible);
        let mean_m = visible().map(|error| error.position_m).sum::<f64>() / visible().count() as f64;
        assert!(mean_m < 0.07, "{mean_m}");
        let nis = outcome.nis.summary(0.95).unwrap().unwrap();
        assert_eq!(nis.square_count, outcome.measured_count);
        assert!((0.7..1.3).contains(&nis.per_degree) && nis.inside > 0.9, "{nis:?}");
        let [visible, occluded] = outcome.nees.each_ref().map(|nees| nees.summary(0.95).unwrap().unwrap());
        assert_eq!(visible.tick_count + occluded.tick_count, 189);
        assert_eq!((outcome.fault_count, outcome.errors.len()), (0, 189));
    }

    #[test]
    fn every_method_goes_through_gaps_without_a_fault() {
        for method in TrackingMethod::ALL {
            let outcome = follow(method);
            let occluded = || outcome.errors.iter().filter(|error| !error.visible);
            assert!(occluded().count() > 20);
            let worst_m = occluded().map(|error| error.position_m).fold(0.0, f64::max);
            assert!(worst_m < 6.0, "{}: {worst_m} m", method.name());
            assert_eq!(outcome.fault_count, 0, "{}", method.name());
        }
    }

    #[test]
    fn forecasts_change_the_learned_prior_alone() {
        let [singer, learned] = [TrackingMethod::SingerBicycle, TrackingMethod::Learned].map(follow);
        assert_eq!(singer.errors.len(), learned.errors.len());
        let worst_m =
            singer.errors.iter().zip(&learned.errors).map(|(a, b)| (a.position_m - b.position_m).abs());
        assert!(worst_m.fold(0.0, f64::max) > 1e-3);
    }

    #[test]
    fn later_frames_change_no_earlier_error() {
        for method in [TrackingMethod::Learned, TrackingMethod::WarmStarted] {
            let whole = follow(method);
            let half = follow_until(10_000_000_000, method);
            // The last instant's true velocity needs the next instant.
            assert_eq!(half.errors.len(), 90);
            assert_eq!(half.errors[..], whole.errors[..90]);
        }
    }

    /// An occluded vehicle at a corner where earlier vehicles turned is predicted to turn as well.
    #[test]
    fn retrieval_predicts_a_known_corner_during_occlusion() {
        let forecaster = Forecaster::new(nn::Weights::onboard(), 1).unwrap();
        let (before, now) = (corner(30), corner(6));
        let mut memory = forecaster.memory();
        let scenes = Cut::of(forecaster.config()).scenes(&before);
        forecaster.visit(&before, &scenes, MapInput::None, 1, &mut memory);
        let place = Place { map: MapInput::None, memory: Some(memory) };
        let mean_m = |method| {
            let course =
                Course::new(&now, [0, i64::MAX], Sensor { gap_s: 3.2, sigma_m: 0.02, seed: 1 }, &place);
            let settings = Settings::first();
            let outcome = Follower { method, settings, forecaster: &forecaster }.follow(&course);
            let occluded = || outcome.errors.iter().filter(|error| !error.visible);
            occluded().map(|error| error.position_m).sum::<f64>() / occluded().count() as f64
        };
        let [learned, warm_started] = [TrackingMethod::Learned, TrackingMethod::WarmStarted].map(mean_m);
        assert!(warm_started < 0.97 * learned, "{warm_started} m with the memory, {learned} m without");
    }
}
