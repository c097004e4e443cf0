//! The noise of the detections, learned by type.
//!
//! Every agent keeps its newest measurements. Each new one gives *contrasts* ([`filters::noise`]): what a
//! smooth motion does not explain. [`Noise`] fits their variances over all agents of a type, apart for
//! detections that report their own deviation and for detections that do not. From these variances follows
//! the [`InputModel`] of the next frame.
//!
//! **Correlated noise.** The error of an upstream tracker changes slowly. Contrasts of consecutive
//! measurements then miss most of it. Further contrasts are taken of measurements [`APART_NS`] apart. Their
//! variance l² shows which part of the noise is a process with the correlation time τ = 0.3 s. This process has
//! the variance a². If ρ is its correlation between neighbouring measurements, a contrast has the variance a² g(ρ):
//!
//! ```text
//! g(ρ) = 1 − 1.5 ρ + 0.6 ρ² − 0.1 ρ³      ρ = exp(−Δ/τ)      ρ' = exp(−Δ'/τ)
//! x = l² − s'² − m²      k = 7 s'² / √n
//! a² = (x − k² / x) / (g(ρ') − g(ρ)) · min(1, s² / s'²),  0 if x ≤ k
//! r² = s² + a² ((1 + ρ) / (1 − ρ) − g(ρ))
//! ```
//!
//! Δ and Δ' are the times between the measurements. s² is the variance of the newest consecutive contrasts,
//! and s'² the variance of the consecutive contrasts at the times of the n contrasts of l². m allows for
//! changes of the acceleration. k is the uncertainty of x. The non-negative garrote subtracts k² / x, so that
//! a clear excess counts almost fully [Breiman: *Better subset regression using the nonnegative garrote*,
//! 1995]. A filter assumes independent measurements. With the variance r², its mean over several seconds has
//! the right variance. Until enough measurements are apart to show l², the noise of an upstream tracker may
//! be correlated. So the prior of noisy positions counts as [`APART_PRIOR_COUNT`] contrasts.

mod sensor;
mod view;

use filters::noise::{Measured, Scale, Window};
use filters::wrapped;
use sensor::{BySensor, COUNT_MAX, NUMBERS, PUBLISHED_MIN_COUNT, VARIANCE_MIN};
pub use sensor::{SensorFactors, SensorWindows};
use view::ByView;
pub use view::ViewFactors;
use wire::{AGENT_TYPES, Detection, Header, detection_flags};

use crate::observation::{Found, is_known};
use crate::options::{Association, InputModel, NOISY_M, SensorNoise, TrackerOptions, noisiness};

/// Time between the measurements of the contrasts that show correlated noise.
const APART_NS: u64 = 400_000_000;
/// Longest time between two measurements of one contrast.
const GAP_MAX_NS: u64 = 1_100_000_000;
/// Time within which three positions give a contrast, by type. An acceleration of 3 m/s² adds 0.03 m to a
/// vehicle's, and one of 0.2 m/s² adds 0.03 m to a pedestrian's.
const SHORT_NS: [u64; 3] = [300_000_000, 300_000_000, 1_200_000_000];
/// Number of contrasts as which the prior counts.
const PRIOR_COUNT: f64 = 0.1;
/// A reported deviation is a better prior.
const REPORTED_COUNT: f64 = 2.0;
/// Number of contrasts as which the prior of correlated noise counts.
const APART_PRIOR_COUNT: f64 = 12.0;
/// Smallest deviation that is published, because 0 means unknown.
const PUBLISHED_LEAST: f64 = 1e-4;
/// Number of contrasts from which the noise is also learned by the view.
const BY_VIEW_MIN_COUNT: f64 = 40.0;
/// τ, k √n / s'² and m of the module's equations.
const CORRELATION_S: f64 = 0.3;
const UNCERTAINTY: f64 = 7.0;
const CHANGE_M: f64 = 0.04;
/// Least g(ρ') − g(ρ). Below it, correlated noise looks like independent noise.
const CONTRAST_MIN: f64 = 0.15;
/// Largest factor on a nominal deviation while detections are associated by position. Clutter that tracks follow
/// looks like noise.
const ASSOCIATED_MAX: f64 = 3.0;
/// Largest deviations that are assumed.
const LARGEST: SensorNoise = SensorNoise { position_m: 3.0, heading_rad: 1.5, speed_mps: 10.0 };

/// The newest measurements of an agent, and the contrasts of the newest one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measurements {
    positions: Window<2, 4>,
    apart: Window<2, 4>,
    headings: Window<1, 3>,
    speeds: Window<1, 3>,
    fresh: Contrasts,
}

/// The contrasts of one measurement.
#[derive(Clone, Copy, Debug, Default)]
struct Contrasts {
    is_reported: bool,
    position: Option<[f64; 2]>,
    /// Those of measurements [`APART_NS`] apart.
    apart: Option<([f64; 2], Spacing)>,
    heading_rad: Option<f64>,
    speed_mps: Option<f64>,
}

/// Times between the measurements of both kinds of contrasts, Δ and Δ'.
#[derive(Clone, Copy, Debug, Default)]
struct Spacing {
    next_s: f64,
    apart_s: f64,
}

impl Measurements {
    /// Adds a measurement. `nominal_m` is the deviation of its position for which the variance is learned as
    /// a factor. `weight` is the factor of its sensor if there are several.
    pub fn add(&mut self, found: &Found<'_>, nominal_m: f64, weight: Option<f64>) {
        let Found { detection, agent_type, own_ns } = *found;
        let is_reported = is_reported(detection);
        // The factors of several sensors also hold their reports together.
        if self.fresh.is_reported != is_reported && weight.is_none() {
            *self = Self::default();
        }
        let since_s = |last_ns: Option<i64>| {
            last_ns.map_or(0.0, |last_ns| own_ns.saturating_sub(last_ns).max(0) as f64 / 1e9)
        };
        let spacing =
            Spacing { next_s: since_s(self.positions.newest_ns()), apart_s: since_s(self.apart.newest_ns()) };
        let sigma = weight.map_or(nominal_m, |weight| weight * nominal_m);
        let position = Measured { time_ns: own_ns, value: found.position_m(), sigma };
        let is_apart = self
            .apart
            .newest_ns()
            .is_none_or(|last_ns| own_ns.saturating_sub(last_ns) >= APART_NS.cast_signed());
        let apart = if is_apart { self.apart.add(position, GAP_MAX_NS, 0) } else { None };
        let value = |flag, value: f32| detection.has(flag).then(|| f64::from(value));
        let heading_rad = value(detection_flags::HAS_HEADING, detection.heading_rad);
        let speed_mps = value(detection_flags::HAS_SPEED, detection.speed_mps);
        self.fresh = Contrasts {
            is_reported,
            position: self.positions.add(position, GAP_MAX_NS, SHORT_NS[agent_type.index()]),
            apart: apart.map(|contrast| (contrast, spacing)),
            heading_rad: heading_rad.and_then(|heading| self.add_heading(own_ns, heading)),
            speed_mps: speed_mps
                .and_then(|speed| self.speeds.add(single(own_ns, speed), GAP_MAX_NS, 0))
                .map(|[contrast]| contrast),
        };
    }

    /// Adds a heading modulo π, next to the last one. So a detector that confuses front and rear has no noise
    /// for that.
    fn add_heading(&mut self, own_ns: i64, heading_rad: f64) -> Option<f64> {
        let next_to = |last: f64| last + 0.5 * wrapped(2.0 * (heading_rad - last));
        let unwrapped = self.headings.newest().map_or(heading_rad, |[last]| next_to(last));
        self.headings.add(single(own_ns, unwrapped), GAP_MAX_NS, 0).map(|[contrast]| contrast)
    }

    /// Takes the contrasts of the newest measurement.
    fn take(&mut self) -> Contrasts {
        let is_reported = self.fresh.is_reported;
        std::mem::replace(&mut self.fresh, Contrasts { is_reported, ..Contrasts::default() })
    }
}

const fn single(time_ns: i64, value: f64) -> Measured<1> {
    Measured { time_ns, value: [value], sigma: 1.0 }
}

/// Whether a detection reports the deviation of its position.
fn is_reported(detection: &Detection) -> bool {
    is_known(detection.sigma_m)
}

/// The learned noise of all types.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    of_type: [TypeNoise; 3],
}

/// The learned noise of the detections of one type.
#[derive(Clone, Copy, Debug)]
struct TypeNoise {
    /// Of the positions: without and with a reported deviation.
    positions: [PositionNoise; 2],
    by_view: ByView,
    by_sensor: BySensor,
    heading_rad: Scale,
    speed_mps: Scale,
}

/// Noise of positions, relative to their nominal deviation.
#[derive(Clone, Copy, Debug)]
struct PositionNoise {
    /// Of consecutive measurements, s².
    next: Scale,
    /// Of measurements [`APART_NS`] apart, and of consecutive ones at the same times, l² and s'².
    apart: Scale,
    next_paired: Scale,
    /// Means of the times between measurements and of the nominal deviation.
    spacing: Spacing,
    nominal_m: f64,
}

impl PositionNoise {
    const fn new(prior_count: f64, nominal_m: f64) -> Self {
        Self {
            next: Scale::new(1.0, prior_count, COUNT_MAX),
            apart: Scale::new(1.0, 0.0, COUNT_MAX),
            next_paired: Scale::new(1.0, 0.0, COUNT_MAX),
            spacing: Spacing { next_s: 0.0, apart_s: 0.0 },
            nominal_m,
        }
    }

    fn add(&mut self, contrasts: &Contrasts) {
        let Some(next) = contrasts.position else { return };
        next.into_iter().for_each(|contrast| self.next.add(contrast));
        if let Some((apart, Spacing { next_s, apart_s })) = contrasts.apart {
            apart.into_iter().for_each(|contrast| self.apart.add(contrast));
            next.into_iter().for_each(|contrast| self.next_paired.add(contrast));
            let gain = 1.0 / self.apart.count().max(1.0);
            self.spacing.next_s += gain * (next_s - self.spacing.next_s);
            self.spacing.apart_s += gain * (apart_s - self.spacing.apart_s);
        }
    }

    /// The learned noise, relative to the nominal variance.
    fn learned(&self) -> Learned {
        let [independent, apart, paired] = [&self.next, &self.apart, &self.next_paired].map(Scale::variance);
        let [next, far] =
            [self.spacing.next_s, self.spacing.apart_s].map(|time_s| (-time_s / CORRELATION_S).exp());
        let seen = contrast_variance(next);
        let contrast = contrast_variance(far) - seen;
        if contrast < CONTRAST_MIN {
            return Learned { own: independent, as_independent: independent };
        }
        let change = (CHANGE_M / self.nominal_m).powi(2);
        let (excess, chance) = (apart - paired - change, UNCERTAINTY / self.apart.count().sqrt() * paired);
        let certain = if excess > chance { excess - chance * chance / excess } else { 0.0 };
        let correlated = certain / contrast * (independent / paired).min(1.0);
        Learned {
            own: independent + correlated * (1.0 - seen),
            as_independent: independent + correlated * ((1.0 + next) / (1.0 - next) - seen),
        }
    }

    /// The factor r² on the variance of the nominal deviation.
    fn factor(&self, may_be_correlated: bool) -> f64 {
        let learned = self.learned().as_independent;
        if !may_be_correlated {
            return learned;
        }
        let variance = self.next.variance();
        let is_noisy = noisiness(self.nominal_m * variance.sqrt(), NOISY_M);
        let prior = variance + is_noisy * (1.0 - variance).max(0.0);
        learned + (prior - learned) * APART_PRIOR_COUNT / (APART_PRIOR_COUNT + self.apart.count())
    }

    /// The standard deviation of the positions themselves.
    fn deviation_m(&self, factor_max: f64) -> f64 {
        self.nominal_m * self.learned().own.sqrt().min(factor_max)
    }
}

/// Variances of the noise, relative to the nominal one.
struct Learned {
    /// Of the noise itself.
    own: f64,
    /// Of independent noise that averages as slowly, r².
    as_independent: f64,
}

/// g(ρ): the variance of a contrast of noise with unit variance, of which neighbours have this correlation.
fn contrast_variance(correlation: f64) -> f64 {
    1.0 - correlation * (1.5 - correlation * (0.6 - 0.1 * correlation))
}

impl TypeNoise {
    /// Whether positions with a reported deviation were seen more often.
    fn is_reported(&self) -> bool {
        let [unreported, reported] = &self.positions;
        reported.next.count() > unreported.next.count() + REPORTED_COUNT
    }
}

/// Largest factor on a nominal deviation; `None` if the prior alone is used.
fn factor_max(header: &Header, options: &TrackerOptions) -> Option<f64> {
    match options.association {
        _ if options.has_own_identities(header) => Some(f64::INFINITY),
        Association::Assignment => Some(ASSOCIATED_MAX),
        // Its tracks take a part of all clutter in their gates, so contrasts and likelihoods show little.
        Association::Jpda => None,
    }
}

impl Noise {
    /// The noise of a detector as prior.
    #[must_use]
    pub fn new(options: &TrackerOptions) -> Self {
        let of_type = options.detector.sensor.map(|prior| TypeNoise {
            positions: [PRIOR_COUNT, REPORTED_COUNT].map(|count| PositionNoise::new(count, prior.position_m)),
            by_view: ByView::new(),
            by_sensor: BySensor::new(),
            heading_rad: Scale::new(prior.heading_rad, PRIOR_COUNT, COUNT_MAX),
            speed_mps: Scale::new(prior.speed_mps, PRIOR_COUNT, COUNT_MAX),
        });
        Self { of_type }
    }

    /// Learns from the newest measurement of an agent of this type, which the sensor sees over this way.
    pub fn learn(
        &mut self,
        of_type: usize,
        measurements: &mut Measurements,
        nominal_m: f64,
        line_of_sight_m: Option<[f64; 2]>,
    ) {
        let contrasts = measurements.take();
        let TypeNoise { positions, by_view, heading_rad, speed_mps, .. } = &mut self.of_type[of_type];
        let positions = &mut positions[usize::from(contrasts.is_reported)];
        positions.add(&contrasts);
        if let Some(position) = contrasts.position {
            positions.nominal_m += 0.05 * (nominal_m - positions.nominal_m);
            if let Some(way_m) = line_of_sight_m.filter(|_| positions.next.count() > BY_VIEW_MIN_COUNT) {
                let deviation = positions.next.variance().sqrt();
                by_view.add(way_m, position.map(|contrast| contrast / deviation));
            }
        }
        contrasts.heading_rad.into_iter().for_each(|contrast| heading_rad.add(contrast));
        contrasts.speed_mps.into_iter().for_each(|contrast| speed_mps.add(contrast));
    }

    /// Learns the noise of a sensor from a measurement of an agent of this type. `windows` hold the measurements
    /// of agents; they are used once there are several sensors.
    pub fn learn_sensor(
        &mut self,
        (of_type, agent): (usize, u64),
        windows: &mut SensorWindows,
        found: &Found<'_>,
        nominal_m: f64,
    ) {
        let TypeNoise { positions, by_sensor, .. } = &mut self.of_type[of_type];
        let (sensor, time_ns) = (found.detection.sensor, found.own_ns);
        if by_sensor.see(sensor, is_reported(found.detection), positions.each_ref().map(|of| &of.next)) {
            let measured = Measured { time_ns, value: found.position_m(), sigma: nominal_m };
            let contrasts = windows.add((agent, sensor), measured, GAP_MAX_NS, SHORT_NS[of_type]);
            contrasts.into_iter().for_each(|contrasts| by_sensor.add(sensor, contrasts, nominal_m));
        }
    }

    /// What the tracker assumes of the next frame.
    #[must_use]
    pub fn input_model(&self, header: &Header, options: &TrackerOptions) -> InputModel {
        let mut model = InputModel::of_options(header, options);
        let Some(factor_max) = factor_max(header, options) else {
            return InputModel { steadiness: [0.0; 3], ..model };
        };
        // Identities come from an upstream tracker.
        let may_be_correlated = options.has_own_identities(header);
        model.by_view = ViewFactors::new(header, self.of_type.each_ref().map(|noise| &noise.by_view));
        for agent_type in AGENT_TYPES {
            let i = agent_type.index();
            let (of_type, smooth) = (&self.of_type[i], &options.smooth.sensor[i]);
            let sigma = |scale: &Scale, least: f64, most: f64| scale.variance().sqrt().clamp(least, most);
            let [unreported, reported] = &of_type.positions;
            let deviation =
                |positions: &PositionNoise| positions.factor(may_be_correlated).sqrt().min(factor_max);
            let unreported_m = deviation(unreported) * options.detector.sensor[i].position_m;
            model.sensor[i] = SensorNoise {
                position_m: unreported_m.clamp(smooth.position_m, LARGEST.position_m),
                heading_rad: sigma(&of_type.heading_rad, smooth.heading_rad, LARGEST.heading_rad),
                speed_mps: sigma(&of_type.speed_mps, smooth.speed_mps, LARGEST.speed_mps),
            };
            model.reported_factor[i] = deviation(reported);
            model.by_sensor.set(agent_type, &of_type.by_sensor.variances(), |variances| {
                let [unreported, reported] = of_type.positions.each_ref().map(|positions| {
                    let own = positions.next.variance().max(VARIANCE_MIN);
                    let inflation = positions.factor(may_be_correlated) / own;
                    variances.map(|variance| (inflation * variance).sqrt().min(factor_max))
                });
                let nominal_m = options.detector.sensor[i].position_m;
                let in_m = |factor: f64| (factor * nominal_m).clamp(smooth.position_m, LARGEST.position_m);
                [unreported.map(in_m), reported]
            });
            let used_m = if of_type.is_reported() {
                model.reported_factor[i] * reported.nominal_m
            } else {
                unreported_m
            };
            // Without identities, the constants of a detector associate best, also if its positions are exact.
            let noise_m = if may_be_correlated { used_m } else { used_m.max(NOISY_M) };
            model.set_motion(agent_type, noise_m, &options.smooth, &options.detector);
        }
        model
    }

    /// What tracks of each type publish: the learned deviations of position, heading and speed, in m, rad and
    /// m/s. 0 without enough evidence.
    #[must_use]
    pub fn published(&self, header: &Header, options: &TrackerOptions) -> [[f32; 3]; 3] {
        let Some(factor_max) = factor_max(header, options) else { return [[0.0; 3]; 3] };
        self.of_type.each_ref().map(|of_type| {
            let used = &of_type.positions[usize::from(of_type.is_reported())];
            let known = |scale: &Scale, deviation: f64| {
                if scale.count() < PUBLISHED_MIN_COUNT { 0.0 } else { deviation.max(PUBLISHED_LEAST) as f32 }
            };
            let own = |scale: &Scale| known(scale, scale.variance().sqrt());
            [
                known(&used.next, used.deviation_m(factor_max)),
                own(&of_type.heading_rad),
                own(&of_type.speed_mps),
            ]
        })
    }

    /// The learned deviations of the positions in m, by type and number of the sensor. 0 without enough evidence,
    /// or if there is one sensor.
    #[must_use]
    pub fn of_sensors_m(&self) -> [[f64; NUMBERS]; 3] {
        self.of_type.each_ref().map(|of_type| {
            let used = &of_type.positions[usize::from(of_type.is_reported())];
            of_type.by_sensor.deviations_m(used.learned().own / used.next.variance().max(VARIANCE_MIN))
        })
    }
}

#[cfg(test)]
mod tests;
