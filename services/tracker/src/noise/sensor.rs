//! The noise of positions by the sensor.
//!
//! A vehicle may have several detectors, such as a lidar of 0.05 m and a camera of 0.5 m. Each detection has
//! the number k of its sensor ([`wire::Detection::sensor`]). Detections without a number count as a further
//! sensor. If two sensors take turns, each contrast of four consecutive positions contains the noise of both
//! equally and does not separate them. So up to 32 agents also keep their newest measurements of each sensor.
//! Contrasts of one sensor have the variance v_k, in units of the nominal variance, from n_k contrasts. For
//! each type:
//!
//! ```text
//! ln v = Σ n_k ln v_k / Σ n_k      ln v'_k = ln v + n_k / (n_k + n_0) · (ln v_k − ln v)      n_0 = 10
//! r_k² = v'_k r² / s²              w_k = √(v'_k / v)
//! ```
//!
//! * r_k² is the factor on the nominal variance of the sensor's measurements. r² and s² are the type's.
//! * w_k is a factor on the nominal deviations in the contrasts of s², l² and s'². So s² and r² become the mean of
//!   all sensors, and noise is not taken as correlated because sensors take turns.
//! * If no ln v'_k differs from ln v by more than 0.3, the difference may be chance. All sensors then have the
//!   noise of the type.
//! * Until a second sensor has detected agents of the type, nothing changes, to the bit.

use filters::noise::{Measured, Scale, Window};
use wire::{AgentType, SENSORS_MAX};

/// The numbers of sensors, with 0 for detections that do not report it.
pub const NUMBERS: usize = SENSORS_MAX + 1;
/// n_0 of the module's equation.
const PRIOR_COUNT: f64 = 10.0;
/// Number of contrasts as which the type's variance counts when a sensor's variance is first learned, and the
/// largest number that counts.
const START_COUNT: f64 = 2.0;
pub const COUNT_MAX: f64 = 400.0;
/// Differences of the logarithms of v' and v up to this value occur by chance. They would cost more than they
/// gain.
const DIFFERENCE_MIN: f64 = 0.3;
/// Number of contrasts from which noise is published.
pub const PUBLISHED_MIN_COUNT: f64 = 40.0;
/// Least variance that is learned. Exact positions have none.
pub const VARIANCE_MIN: f64 = 1e-6;
/// Number of agents whose measurements are kept, and of sensors of each. The variances of a type need no more.
const AGENTS_KEPT_MAX: usize = 32;
const KEPT_MAX: usize = 3;

/// Learned variances of one type by the sensor, relative to the nominal variance.
#[derive(Clone, Copy, Debug)]
pub struct BySensor {
    /// The first sensor, and whether it reports deviations.
    first: Option<(u8, bool)>,
    /// Whether several sensors have detected agents of the type.
    is_mixed: bool,
    of: [Scale; NUMBERS],
    /// Means of the nominal deviation.
    nominal_m: [f64; NUMBERS],
}

impl BySensor {
    pub const fn new() -> Self {
        let of = [Scale::new(1.0, 0.0, COUNT_MAX); NUMBERS];
        Self { first: None, is_mixed: false, of, nominal_m: [0.0; NUMBERS] }
    }

    /// Notes the sensor of a measurement. `learned` are the variances of the type without and with reported
    /// deviations. They are the first sensor's, and the prior of all others. Returns whether there are several
    /// sensors.
    pub fn see(&mut self, sensor: u8, is_reported: bool, learned: [&Scale; 2]) -> bool {
        let (first, first_reported) = *self.first.get_or_insert((sensor, is_reported));
        if sensor != first && !self.is_mixed {
            let learned = learned[usize::from(first_reported)];
            let sigma = learned.variance().sqrt();
            self.is_mixed = true;
            self.of = [Scale::new(sigma, START_COUNT, COUNT_MAX); NUMBERS];
            self.of[usize::from(first)] = Scale::new(sigma, learned.count().max(START_COUNT), COUNT_MAX);
        }
        self.is_mixed
    }

    /// Learns from the contrasts of consecutive measurements of one sensor, in units of the nominal deviation.
    pub fn add(&mut self, sensor: u8, contrasts: [f64; 2], nominal_m: f64) {
        let sensor = usize::from(sensor);
        contrasts.into_iter().for_each(|contrast| self.of[sensor].add(contrast));
        let mean_m = &mut self.nominal_m[sensor];
        *mean_m = if *mean_m > 0.0 { *mean_m + 0.05 * (nominal_m - *mean_m) } else { nominal_m };
    }

    /// The standard deviations of the sensors' positions. 0 without enough evidence, or if there is one sensor.
    pub fn deviations_m(&self, inflation: f64) -> [f64; NUMBERS] {
        std::array::from_fn(|k| {
            let is_known =
                self.is_mixed && self.nominal_m[k] > 0.0 && self.of[k].count() >= PUBLISHED_MIN_COUNT;
            if is_known { self.nominal_m[k] * (inflation * self.of[k].variance()).sqrt() } else { 0.0 }
        })
    }

    /// v and v' of the module's equation.
    pub fn variances(&self) -> Variances {
        if !self.is_mixed {
            return Variances::OneSensor;
        }
        let counts = self.of.each_ref().map(|scale| scale.count() - START_COUNT);
        let logarithms = self.of.each_ref().map(|scale| scale.variance().max(VARIANCE_MIN).ln());
        let sum = logarithms.iter().zip(counts).map(|(logarithm, count)| count * logarithm).sum::<f64>();
        let mean = sum / counts.iter().sum::<f64>();
        let of =
            std::array::from_fn(|k| mean + (logarithms[k] - mean) * counts[k] / (counts[k] + PRIOR_COUNT));
        if of.iter().any(|logarithm: &f64| (logarithm - mean).abs() > DIFFERENCE_MIN) {
            Variances::Differ { mean: mean.exp(), of: of.map(f64::exp) }
        } else {
            Variances::Equal
        }
    }
}

/// What is known of the sensors of a type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Variances {
    /// There is one sensor.
    OneSensor,
    /// There are several of about the same noise.
    Equal,
    /// The mean v and the variance v' of each sensor.
    Differ { mean: f64, of: [f64; NUMBERS] },
}

/// The factors on the nominal deviations of positions in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorFactors {
    of_type: [TypeFactors; 3],
}

/// The factors of one type, by sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TypeFactors {
    has_several: bool,
    /// w_k of the module's equation.
    weights: [f64; NUMBERS],
    /// Of measurements without and with a reported deviation: the deviation in m, and the factor r_k. `None` if
    /// the sensors do not differ.
    deviations: Option<[[f64; NUMBERS]; 2]>,
}

impl SensorFactors {
    /// One sensor.
    pub const NONE: Self =
        Self { of_type: [TypeFactors { has_several: false, weights: [1.0; NUMBERS], deviations: None }; 3] };

    /// Sets the factors of a type. `deviations` gives the values of [`SensorFactors::deviation`] for variances.
    pub fn set(
        &mut self,
        agent_type: AgentType,
        variances: &Variances,
        deviations: impl FnOnce(&[f64; NUMBERS]) -> [[f64; NUMBERS]; 2],
    ) {
        let of_type = &mut self.of_type[agent_type.index()];
        of_type.has_several = *variances != Variances::OneSensor;
        if let Variances::Differ { mean, of } = variances {
            of_type.weights = of.map(|variance| (variance / mean).sqrt());
            of_type.deviations = Some(deviations(of));
        }
    }

    /// w_k of the module's equation; `None` if there is one sensor.
    pub fn weight(&self, agent_type: AgentType, sensor: u8) -> Option<f64> {
        let of_type = &self.of_type[agent_type.index()];
        of_type.weights.get(usize::from(sensor)).copied().filter(|_| of_type.has_several)
    }

    /// The deviation of a sensor's positions in m, or the factor on the deviation that they report; `None` if
    /// the sensors do not differ.
    pub fn deviation(&self, agent_type: AgentType, sensor: u8, is_reported: bool) -> Option<f64> {
        let deviations = self.of_type[agent_type.index()].deviations.as_ref()?;
        deviations[usize::from(is_reported)].get(usize::from(sensor)).copied()
    }
}

/// The newest measurements of some agents by the sensor.
#[derive(Debug)]
pub struct SensorWindows {
    agents: Vec<AgentWindows>,
}

/// The newest measurements of one agent by the sensor.
#[derive(Clone, Copy, Debug)]
struct AgentWindows {
    agent: u64,
    newest_ns: i64,
    kept: [(u8, Window<2, 4>); KEPT_MAX],
}

impl SensorWindows {
    #[must_use]
    pub fn new() -> Self {
        Self { agents: Vec::with_capacity(AGENTS_KEPT_MAX) }
    }

    /// Copies `source` into the existing memory.
    pub fn copy(&mut self, source: &Self) {
        self.agents.clone_from(&source.agents);
    }

    /// Forgets all measurements.
    pub fn clear(&mut self) {
        self.agents.clear();
    }

    /// Adds an agent's measurement by a sensor, as [`Window::add`] does. A further agent needs the place of one
    /// without measurements in the last `gap_max_ns`.
    pub fn add(
        &mut self,
        (agent, sensor): (u64, u8),
        newest: Measured<2>,
        gap_max_ns: u64,
        short_ns: u64,
    ) -> Option<[f64; 2]> {
        let windows = self.of_agent(agent, newest.time_ns, gap_max_ns)?;
        windows.newest_ns = windows.newest_ns.max(newest.time_ns);
        let own = windows.kept.iter().position(|(of, window)| *of == sensor && window.newest_ns().is_some());
        // Without room, it replaces the sensor that was not used for the longest time.
        let oldest = || (0..KEPT_MAX).min_by_key(|&place| windows.kept[place].1.newest_ns());
        let place = own.or_else(oldest)?;
        if own.is_none() {
            windows.kept[place] = (sensor, Window::new());
        }
        windows.kept[place].1.add(newest, gap_max_ns, short_ns)
    }

    fn of_agent(&mut self, agent: u64, now_ns: i64, gap_max_ns: u64) -> Option<&mut AgentWindows> {
        let new = AgentWindows { agent, newest_ns: now_ns, kept: Default::default() };
        let own = self.agents.iter().position(|of| of.agent == agent);
        let place = own.or_else(|| {
            let is_over = |of: &AgentWindows| now_ns.abs_diff(of.newest_ns) > gap_max_ns;
            let place = self.agents.iter().position(is_over);
            match place {
                Some(place) => self.agents[place] = new,
                None if self.agents.len() < AGENTS_KEPT_MAX => self.agents.push(new),
                None => return None,
            }
            Some(place.unwrap_or(self.agents.len() - 1))
        });
        self.agents.get_mut(place?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAP_MAX_NS: u64 = 1_100_000_000;

    /// The number of the sensor that gives contrasts, for measurements of these sensors 50 ms apart. All values
    /// of a sensor are equal, so its own contrasts are 0.
    fn giving(sensors: &[u8]) -> Vec<u8> {
        let mut windows = SensorWindows::new();
        let mut giving = Vec::new();
        for (&sensor, time_ns) in sensors.iter().zip((0..).step_by(50_000_000)) {
            let measured = Measured { time_ns, value: [f64::from(sensor); 2], sigma: 1.0 };
            if let Some(contrasts) = windows.add((7, sensor), measured, GAP_MAX_NS, 0) {
                assert_eq!(contrasts, [0.0; 2], "contrasts of one sensor");
                giving.push(sensor);
            }
        }
        giving
    }

    #[test]
    fn contrasts_are_of_one_sensor() {
        assert_eq!(giving(&[1, 2].repeat(5)), [1, 2, 1, 2]);
        assert_eq!(giving(&[0, 2, 3].repeat(4)), [0, 2, 3]);
        assert_eq!(giving(&[1, 2, 3, 1, 2, 1, 2, 4, 1, 2]), [1, 2], "the fourth replaces the third");
    }

    #[test]
    fn further_agents_take_the_places_of_agents_that_are_gone() {
        let mut windows = SensorWindows::new();
        let mut add = |agent: u64, time_ns: i64| {
            let measured = Measured { time_ns, value: [0.0; 2], sigma: 1.0 };
            windows.add((agent, 1), measured, GAP_MAX_NS, 0).is_some()
        };
        let agents = 0..AGENTS_KEPT_MAX as u64 + 5;
        let giving = |at_ns: i64, add: &mut dyn FnMut(u64, i64) -> bool| {
            (0..4).map(|k| agents.clone().filter(|&agent| add(agent, at_ns + k * 50_000_000)).count()).last()
        };
        assert_eq!(giving(0, &mut add), Some(AGENTS_KEPT_MAX));
        let last = AGENTS_KEPT_MAX as u64 + 4;
        assert_eq!([5, 6, 7, 8].map(|s| add(last, s * 500_000_000)), [false, false, false, true]);
    }

    fn learned(scales: [f64; 2], count: usize) -> BySensor {
        let mut learned = BySensor::new();
        let prior = Scale::new(1.0, 0.1, COUNT_MAX);
        assert_eq!([1, 2].map(|sensor| learned.see(sensor, false, [&prior; 2])), [false, true]);
        for sign in [-1.0, 1.0].repeat(count) {
            [1, 2]
                .into_iter()
                .zip(scales)
                .for_each(|(sensor, scale)| learned.add(sensor, [scale * sign; 2], 0.1));
        }
        learned
    }

    #[test]
    fn sensors_differ_if_their_variances_do() {
        assert_eq!(BySensor::new().variances(), Variances::OneSensor);
        assert_eq!(learned([1.0, 1.1], 100).variances(), Variances::Equal);
        assert_eq!(learned([1.0, 5.0], 1).variances(), Variances::Equal, "two measurements may be chance");
        let Variances::Differ { mean, of } = learned([0.5, 4.0], 200).variances() else {
            panic!("sensors that differ")
        };
        let ratio = (of[2] / of[1]).sqrt();
        assert!((6.0..8.0).contains(&ratio), "{ratio}");
        assert!((of[0] / mean - 1.0).abs() < 1e-12, "a sensor that was never seen has the mean");
    }

    #[test]
    fn exact_sensors_have_finite_variances() {
        let Variances::Differ { mean, of } = learned([0.0, 1.0], 200).variances() else {
            panic!("sensors that differ")
        };
        assert!(mean > 0.0 && of.iter().all(|variance| variance.is_finite() && *variance > 0.0), "{of:?}");
    }
}
