//! One matured forecast, and its errors.

use std::collections::BTreeMap;

use conflicts::Odds;
use evidence::{KNOTS, MotionNow};
use metrics::{Anchors, Errors, HighestDensity, Point, displacement, min_displacement};
use scene::{AgentType, State};
use wire::{Expert, Forecast, MODES_MAX, Quality};

use super::Gaussian;
use crate::footage::SEED;
use crate::lines::Candidate;
use crate::playback::{Truth, type_of};

/// Steps at which coverage is evaluated: 0.4, 1.2, 2.4 s and the last.
pub(crate) const STEPS: [usize; 4] = [0, 2, 5, 11];
/// The forecast misses if its final position is farther away than this.
const MISS_M: f64 = 2.0;
/// Level of the region whose area is reported.
pub(crate) const LEVEL: f64 = 0.9;

wire::named! {
    /// The methods that are compared.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Method {
        /// The published single best forecast.
        Best => "Best",
        /// The published mode with the least error.
        BestOf => "BestOf",
        /// Constant velocity.
        ConstantVelocity => "ConstantVelocity",
        /// A turn whose rate decays.
        DecayingTurn => "DecayingTurn",
        /// An acceleration that decays.
        DecayingAcceleration => "DecayingAcceleration",
        /// The best of 20 anchors on constant velocity.
        Anchors => "Anchors",
    }
}

/// A matured forecast.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// The agent's identity, the same in all of its samples.
    pub agent: u64,
    /// Type of the agent.
    pub agent_type: AgentType,
    /// Tracked speed of the agent, m/s.
    pub speed_mps: f32,
    /// Time since the recording began, s.
    pub recording_s: f64,
    /// Time since the source began, s.
    pub source_s: f64,
    /// Whether another agent is on its way, a short distance ahead.
    pub has_leader: bool,
    /// Errors by [`Method`].
    pub errors: [Errors; Method::ALL.len()],
    /// Level of the highest-density region whose border passes through the truth, at each of the `STEPS`.
    pub levels: [f64; STEPS.len()],
    /// Area of the 90 % highest-density region at the end, m².
    pub area_m2: f64,
    /// Negative logarithm of the mixture's density at the truth at the end.
    pub nll: f64,
    /// Whether the single best forecast ends more than 2 m off.
    pub missed: bool,
    /// Whether the forecast was published as learned.
    pub learned: bool,
    /// Weight of the network.
    pub network: f32,
    /// Published out-of-distribution measure.
    pub out_of_distribution: f32,
    /// Residual of the truth to constant velocity at the end, along and across the course, m.
    pub beyond_steady_m: [f32; 2],
    /// Residual of the truth to the mean of constant velocity and the single best forecast, at the steps of
    /// [`evidence::knots`], along and across the course, m.
    pub residuals_m: [[f32; 2]; KNOTS],
}

/// Turns forecasts into samples; reuses its memory.
pub(crate) struct Judge<'a> {
    pub(crate) anchors: &'a BTreeMap<AgentType, Anchors>,
    pub(crate) odds: &'a Odds,
    pub(crate) levels: HighestDensity,
    pub(crate) dt_s: f32,
    pub(crate) horizon_len: usize,
}

/// A sample, its truth, and the forecasts of the baselines.
pub(crate) struct Judged {
    pub(crate) sample: Sample,
    /// Position at each step.
    pub(crate) truth_m: Vec<Option<Point>>,
    /// The forecasts of the baselines by name.
    pub(crate) baselines: [(&'static str, Candidate); 4],
}

#[cfg(test)]
impl Sample {
    /// A sample of this type and speed with default values.
    pub(crate) fn of(agent_type: AgentType, speed_mps: f32) -> Self {
        Self {
            agent: 1,
            agent_type,
            speed_mps,
            recording_s: 0.0,
            source_s: 0.0,
            has_leader: false,
            errors: Default::default(),
            levels: Default::default(),
            area_m2: 0.0,
            nll: 0.0,
            missed: false,
            learned: true,
            network: 1.0,
            out_of_distribution: 0.0,
            beyond_steady_m: Default::default(),
            residuals_m: Default::default(),
        }
    }
}

impl Sample {
    /// Whether the published region of this level held the truth at `STEPS[step]`.
    pub(crate) fn is_held(&self, level: f64, step: usize) -> bool {
        self.levels[step] <= level
    }
}

impl Judge<'_> {
    /// The positions of an agent over the horizon; `None` if the recording does not have all of them.
    pub(crate) fn truth(&self, truth: &Truth, stamp_ns: i64, agent: u64) -> Option<Vec<Option<Point>>> {
        truth.ahead(agent, stamp_ns, f64::from(self.dt_s) * 1e9, self.horizon_len)
    }

    /// The sample of a forecast; `None` if the recording does not have the agent for the whole horizon.
    pub(crate) fn judge(
        &mut self,
        truth: &Truth,
        stamp_ns: i64,
        forecast: &Forecast,
        before: Option<([f32; 2], f32)>,
        agent: u64,
    ) -> Option<Judged> {
        let len = self.horizon_len;
        let truth = self.truth(truth, stamp_ns, agent)?;
        let agent_type = type_of(forecast)?;
        let now = MotionNow::since([forecast.x_m, forecast.y_m], [forecast.vx_mps, forecast.vy_mps], before);
        let path = |of: &dyn Fn(&mut [[f32; 2]])| {
            let mut path = vec![[0.0; 2]; len];
            of(&mut path);
            path
        };
        let modes_len = forecast.modes_len as usize;
        let modes = &forecast.modes[..modes_len];
        let state = State {
            position_m: now.position_m,
            velocity_mps: now.velocity_mps,
            heading_rad: forecast.heading_rad,
        };
        let anchors = self.anchors.get(&agent_type).and_then(|anchors| anchors.predict(&[Some(state)]));
        let anchors = anchors.unwrap_or_default();
        let steady = path(&|path| now.steady(self.dt_s, path));
        let turning = path(&|path| now.turning(self.dt_s, path));
        let accelerating = path(&|path| now.accelerating(self.dt_s, path));
        let errors = Method::ALL.map(|method| {
            Errors::of(match method {
                Method::Best => displacement(&forecast.best, &truth),
                Method::BestOf => min_displacement(modes, &truth),
                Method::ConstantVelocity => displacement(&steady, &truth),
                Method::DecayingTurn => displacement(&turning, &truth),
                Method::DecayingAcceleration => displacement(&accelerating, &truth),
                Method::Anchors => min_displacement(&anchors, &truth),
            })
        });
        let course = now.course(forecast.heading_rad);
        let probability = &forecast.probability[..modes_len];
        let levels = STEPS.map(|step| {
            let step = step.min(len - 1);
            let (means, covariances) = at_step(forecast, step);
            let truth = truth[step].unwrap_or_default();
            self.levels.level(&means[..modes_len], &covariances[..modes_len], probability, truth, SEED)
        });
        let last = len - 1;
        let (means, covariances) = at_step(forecast, last);
        let end = truth[last].unwrap_or_default();
        let sample = Sample {
            agent,
            agent_type,
            speed_mps: now.speed_mps(),
            recording_s: 0.0,
            source_s: 0.0,
            has_leader: false,
            errors,
            levels,
            area_m2: self.levels.area_m2(
                &means[..modes_len],
                &covariances[..modes_len],
                probability,
                LEVEL,
                SEED,
            ),
            nll: nll_at(forecast, last, end),
            missed: errors[0].fde_m > MISS_M,
            learned: forecast.quality == Quality::Learned as u32,
            network: forecast.expert_weights[Expert::Network as usize],
            out_of_distribution: forecast.out_of_distribution,
            beyond_steady_m: beyond_m(course, end, steady[last]),
            residuals_m: residuals_m(course, &truth, &steady, forecast),
        };
        let single = |single| Candidate { single: Some(single), ..Candidate::default() };
        let baselines = [
            ("constant velocity", single(steady)),
            ("turn", single(turning)),
            ("acceleration", single(accelerating)),
            ("20 anchors", Candidate { modes: anchors, ..Candidate::default() }),
        ];
        Some(Judged { sample, truth_m: truth, baselines })
    }
}

/// Means and covariances of all modes at a step.
pub(crate) fn at_step(forecast: &Forecast, step: usize) -> ([Point; MODES_MAX], [[f32; 3]; MODES_MAX]) {
    (forecast.modes.map(|mode| mode[step]), forecast.mode_covariance.map(|mode| mode[step]))
}

/// The offset of a position from another one, along and across a course with this cosine and sine.
fn beyond_m([cos, sin]: [f32; 2], truth_m: Point, from_m: Point) -> [f32; 2] {
    let [x, y] = [0, 1].map(|axis| truth_m[axis] - from_m[axis]);
    [x * cos + y * sin, y * cos - x * sin]
}

/// Residuals of the truth to the mean of constant velocity and the single best forecast, at the knots of a
/// [fan](evidence::knots), along and across the course.
pub(crate) fn residuals_m(
    course: [f32; 2],
    truth_m: &[Option<Point>],
    steady_m: &[Point],
    forecast: &Forecast,
) -> [[f32; 2]; KNOTS] {
    evidence::knots(truth_m.len()).map(|step| {
        let middle_m = [0, 1].map(|axis| 0.5 * (steady_m[step][axis] + forecast.best[step][axis]));
        beyond_m(course, truth_m[step].unwrap_or_default(), middle_m)
    })
}

/// Negative log density of the modes of a forecast at a step.
pub(crate) fn nll_at(forecast: &Forecast, step: usize, truth: Point) -> f64 {
    let modes_len = (forecast.modes_len as usize).min(MODES_MAX);
    let (means, covariances) = at_step(forecast, step);
    nll(&means[..modes_len], &covariances[..modes_len], &forecast.probability[..modes_len], truth)
}

/// Negative log density of a mixture. The variance of each mode is at least (1 cm)².
fn nll(means: &[[f32; 2]], covariances: &[[f32; 3]], probability: &[f32], truth: [f32; 2]) -> f64 {
    let parts = means.iter().zip(covariances).zip(probability).map(|((mean, covariance), p)| {
        let gaussian = Gaussian::new(mean.map(f64::from), covariance.map(f64::from));
        let spread = 0.5 * gaussian.determinant().ln() + std::f64::consts::TAU.ln();
        f64::from(*p).max(1e-12).ln() - 0.5 * gaussian.square(truth) - spread
    });
    let parts: Vec<f64> = parts.collect();
    let most = parts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    -(most + parts.iter().map(|part| (part - most).exp()).sum::<f64>().ln())
}
