//! The base control: what a forecast begins with before the network adds anything.
//!
//! A ridge regression per history class and speed bin gives a control sequence from 26 features of the newest states.
//! What is left between its forecasts and the recorded futures falls into 20 clusters per bin of (speed, acceleration,
//! yaw rate); the mean control residual of a cluster is an *anchor*. Ridge plus anchors alone is a forecaster with
//! modes, and the network starts from it.

mod targets;

use burn::tensor::Device;
use metrics::kmeans;
use nalgebra::{DMatrix, SMatrix};
use nn::{ModelConfig, base as binning, base::BaseFeatures};
use scene::{AgentFrame, AgentType, FeatureScales, State, agent_frame, state_features};

use wire::AGENT_TYPES;

use crate::batch::{Start, in_frame};
use crate::model::TYPE_NAMES;
use crate::parameters::{Parameters, Role};
use crate::samples::Agent;
use targets::{Controls, Driver};

/// Penalty on the squared ridge coefficients.
const RIDGE: f64 = 1.0;
/// A bin with fewer windows takes the anchors or coefficients of its neighbour.
const WINDOWS_MIN: usize = 60;
const KMEANS_ITERATIONS: usize = 30;
/// Windows per bin that the clustering looks at.
const CLUSTERED_MAX: usize = 4000;

type Features = [f32; binning::FEATURES];

/// The base control of all agent types.
#[derive(Clone, Debug)]
pub(crate) struct BaseControl {
    config: ModelConfig,
    types: Vec<TypeBase>,
}

#[derive(Clone, Debug)]
struct TypeBase {
    speed_cuts_mps: [f32; binning::SPEED_BINS - 1],
    /// `[classes, speed bins, features, controls]`.
    ridge: Vec<f32>,
    /// `[bins, modes + 1, controls]`; the last of each bin is zero, for the single best forecast.
    anchors: Vec<f32>,
}

/// Base control of one agent.
pub(crate) struct AgentBase<'a> {
    /// `[horizon × 2]`.
    pub(crate) ridge: Vec<f32>,
    /// `[(modes + 1) × horizon × 2]`.
    pub(crate) anchors: &'a [f32],
}

impl BaseControl {
    /// A base that adds nothing: constant velocity for cyclists and pedestrians, no control for vehicles.
    pub(crate) fn zero(config: &ModelConfig) -> Self {
        let zero = |agent_type: &AgentType| TypeBase::zero(config, *agent_type);
        Self { config: config.clone(), types: AGENT_TYPES.iter().map(zero).collect() }
    }

    /// Fits ridge and anchors to the agents whose future is known, each with its history cut to every class.
    pub(crate) fn fit<'a>(config: &ModelConfig, agents: impl Iterator<Item = &'a Agent> + Clone, seed: u64) -> Self {
        let types = AGENT_TYPES.iter().map(|&agent_type| {
            let mut zero = TypeBase::zero(config, agent_type);
            let of_type = agents.clone().filter(|agent| agent.agent_type == agent_type && agent.counts);
            let samples: Vec<Sample> =
                of_type.flat_map(|agent| Sample::of_every_class(agent, config, &zero.speed_cuts_mps)).collect();
            zero.fit(&samples, config, seed);
            zero
        });
        Self { config: config.clone(), types: types.collect() }
    }

    /// The base control of an agent with this history.
    pub(crate) fn of(&self, agent_type: AgentType, history: &[Option<State>], frame: &AgentFrame) -> AgentBase<'_> {
        let base = &self.types[agent_type as usize];
        let (features, place) = describe(history, frame, &base.speed_cuts_mps, &self.config);
        let controls_len = 2 * self.config.horizon_len;
        let per_bin = (self.config.modes + 1) * controls_len;
        AgentBase {
            ridge: base.ridge(&features, place, controls_len),
            anchors: &base.anchors[place.bin * per_bin..][..per_bin],
        }
    }

    /// Adds the tensors `base.*`.
    pub(crate) fn store(&self, parameters: &mut Parameters, device: &Device) {
        let controls_len = 2 * self.config.horizon_len;
        let (modes, horizon) = (self.config.modes, self.config.horizon_len);
        for (name, base) in TYPE_NAMES.iter().zip(&self.types) {
            let mut fixed = |tensor: &str, shape: &[usize], values: Vec<f32>| {
                parameters.insert(&format!("base.{name}.{tensor}"), shape, values, Role::Fixed, device);
            };
            let shape = [binning::CLASSES, binning::SPEED_BINS, binning::FEATURES, controls_len];
            fixed("ridge", &shape, base.ridge.clone());
            let per_bin = base.anchors.chunks_exact((modes + 1) * controls_len);
            let anchors = per_bin.flat_map(|bin| &bin[..modes * controls_len]).copied().collect();
            fixed("anchors", &[binning::BINS, modes, horizon, 2], anchors);
            fixed("speed_cuts", &[binning::SPEED_BINS - 1], base.speed_cuts_mps.to_vec());
        }
    }

    /// Reads the tensors `base.*` back; `None` where they are missing.
    pub(crate) fn load(parameters: &Parameters, config: &ModelConfig) -> Option<Self> {
        let controls_len = 2 * config.horizon_len;
        let types = TYPE_NAMES.iter().map(|name| {
            let values = |tensor: &str| parameters.values(&format!("base.{name}.{tensor}"));
            let per_bin = config.modes * controls_len;
            let with_zero = |bin: &[f32]| bin.iter().copied().chain(std::iter::repeat_n(0.0, controls_len)).collect();
            Some(TypeBase {
                speed_cuts_mps: values("speed_cuts")?.try_into().ok()?,
                ridge: values("ridge")?,
                anchors: values("anchors")?.chunks_exact(per_bin).flat_map(|bin| -> Vec<f32> { with_zero(bin) }).collect(),
            })
        });
        Some(Self { config: config.clone(), types: types.collect::<Option<_>>()? })
    }
}

/// Where in the tables an agent belongs.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    class: usize,
    speed_bin: usize,
    bin: usize,
}

/// What moves an agent.
enum Mover {
    Vehicle(Driver),
    Other { velocity_mps: [f32; 2], dt_s: f32 },
}

impl Mover {
    fn positions(&self, controls: &[[f32; 2]]) -> Vec<[f32; 2]> {
        match self {
            Self::Vehicle(driver) => driver.positions(controls),
            Self::Other { velocity_mps, dt_s } => targets::displaced(*velocity_mps, controls, *dt_s),
        }
    }

    fn controls(&self, truth: &[[f32; 2]]) -> Controls {
        match self {
            Self::Vehicle(driver) => driver.controls(truth),
            Self::Other { velocity_mps, dt_s } => targets::displacements(*velocity_mps, truth, *dt_s),
        }
    }
}

/// A window as the fit sees it.
struct Sample {
    place: Place,
    features: Features,
    mover: Mover,
    /// Recorded positions in the agent frame.
    truth: Vec<[f32; 2]>,
    /// The controls that make them.
    controls: Controls,
}

impl Sample {
    /// The window with its whole history and, where that is long enough, cut to the shorter classes.
    fn of_every_class(agent: &Agent, config: &ModelConfig, cuts_mps: &[f32]) -> Vec<Self> {
        let present = agent.history.iter().rev().take_while(|state| state.is_some()).count();
        let lens = [2, 3, config.history_len].into_iter().filter(|&len| len <= present || len == config.history_len);
        lens.filter_map(|len| Self::new(agent, &agent.history_of(len), config, cuts_mps)).collect()
    }

    fn new(agent: &Agent, history: &[Option<State>], config: &ModelConfig, cuts_mps: &[f32]) -> Option<Self> {
        let frame = agent_frame(history)?;
        let truth: Vec<[f32; 2]> = agent.future.iter().map(|state| Some(in_frame(&frame, (*state)?.position_m))).collect::<Option<_>>()?;
        let newest = history.last().copied().flatten()?;
        let dt_s = config.dt_s as f32;
        let mover = match agent.agent_type {
            AgentType::Vehicle => Mover::Vehicle(Driver::new(&Start::of(agent, history, &frame, config), config)),
            AgentType::Cyclist | AgentType::Pedestrian => {
                Mover::Other { velocity_mps: frame.rotate_into(newest.velocity_mps), dt_s }
            }
        };
        let (features, place) = describe(history, &frame, cuts_mps, config);
        let controls = mover.controls(&truth);
        Some(Self { place, features, mover, truth, controls })
    }
}

fn describe(history: &[Option<State>], frame: &AgentFrame, cuts_mps: &[f32], config: &ModelConfig) -> (Features, Place) {
    let scales = FeatureScales { position: config.position_scale, velocity: config.velocity_scale };
    let states: Vec<[f32; 6]> =
        history.iter().map(|state| state.map_or([0.0; 6], |state| state_features(frame, &state, scales))).collect();
    let features = BaseFeatures::new(&states, |step| history[step].is_some(), config);
    let place = Place {
        class: features.class,
        speed_bin: features.speed_bin(cuts_mps),
        bin: features.anchor_bin(cuts_mps),
    };
    (features.values, place)
}

impl TypeBase {
    fn zero(config: &ModelConfig, agent_type: AgentType) -> Self {
        let controls_len = 2 * config.horizon_len;
        Self {
            speed_cuts_mps: metrics::speed_cuts_mps(agent_type),
            ridge: vec![0.0; binning::CLASSES * binning::SPEED_BINS * binning::FEATURES * controls_len],
            anchors: vec![0.0; binning::BINS * (config.modes + 1) * controls_len],
        }
    }

    fn ridge(&self, features: &Features, place: Place, controls_len: usize) -> Vec<f32> {
        let per_bin = binning::FEATURES * controls_len;
        let table = &self.ridge[(place.class * binning::SPEED_BINS + place.speed_bin) * per_bin..][..per_bin];
        let mut controls = vec![0.0; controls_len];
        for (feature, row) in features.iter().zip(table.chunks_exact(controls_len)) {
            controls.iter_mut().zip(row).for_each(|(control, weight)| *control += feature * weight);
        }
        controls
    }

    fn fit(&mut self, samples: &[Sample], config: &ModelConfig, seed: u64) {
        let controls_len = 2 * config.horizon_len;
        let per_bin = binning::FEATURES * controls_len;
        for class in 0..binning::CLASSES {
            let of_class: Vec<&Sample> = samples.iter().filter(|sample| sample.place.class == class).collect();
            let pooled = || ridge_regression(&of_class, controls_len);
            let own: Vec<Option<Vec<f32>>> = (0..binning::SPEED_BINS)
                .map(|bin| of_class.iter().copied().filter(|s| s.place.speed_bin == bin).collect::<Vec<_>>())
                .map(|of_bin| (of_bin.len() >= WINDOWS_MIN).then(|| ridge_regression(&of_bin, controls_len)))
                .collect();
            for bin in 0..binning::SPEED_BINS {
                let solution = match &own[bin] {
                    Some(own) => own.clone(),
                    None => nearest(&own, |other| bin.abs_diff(other)).cloned().unwrap_or_else(pooled),
                };
                self.ridge[(class * binning::SPEED_BINS + bin) * per_bin..][..per_bin].copy_from_slice(&solution);
            }
        }
        self.fit_anchors(samples, config.modes, controls_len, seed);
    }

    fn fit_anchors(&mut self, samples: &[Sample], modes: usize, controls_len: usize, seed: u64) {
        let longest = samples.iter().filter(|sample| sample.place.class + 1 == binning::CLASSES);
        let mut by_bin: Vec<Vec<&Sample>> = vec![Vec::new(); binning::BINS];
        longest.for_each(|sample| by_bin[sample.place.bin].push(sample));
        let own: Vec<Option<Vec<f32>>> = by_bin
            .iter()
            .map(|of_bin| (of_bin.len() >= WINDOWS_MIN).then(|| self.cluster(of_bin, modes, controls_len, seed)))
            .collect();
        let all: Vec<&Sample> = by_bin.iter().flatten().copied().collect();
        let pooled = (all.len() >= modes).then(|| self.cluster(&all, modes, controls_len, seed));
        let per_bin = (modes + 1) * controls_len;
        for bin in 0..binning::BINS {
            let anchors = own[bin].as_ref().or_else(|| nearest(&own, |other| bin_distance(bin, other)));
            if let Some(anchors) = anchors.or(pooled.as_ref()) {
                self.anchors[bin * per_bin..][..modes * controls_len].copy_from_slice(anchors);
            }
        }
    }

    /// Mean control residuals of the clusters of position residuals, `[modes × controls]`, largest cluster first.
    fn cluster(&self, samples: &[&Sample], modes: usize, controls_len: usize, seed: u64) -> Vec<f32> {
        let stride = samples.len().div_ceil(CLUSTERED_MAX);
        let samples: Vec<&Sample> = samples.iter().copied().step_by(stride).collect();
        let mut positions = Vec::with_capacity(samples.len() * controls_len);
        let mut residuals = Vec::with_capacity(samples.len() * controls_len);
        for sample in &samples {
            let ridge = self.ridge(&sample.features, sample.place, controls_len);
            let (ridge, _) = ridge.as_chunks::<2>();
            let forecast = sample.mover.positions(ridge);
            positions.extend(sample.truth.iter().flatten().zip(forecast.iter().flatten()).map(|(t, f)| t - f));
            residuals.extend(sample.controls.iter().flatten().zip(ridge.iter().flatten()).map(|(c, r)| c - r));
        }
        let clusters = kmeans(&positions, controls_len, modes, seed, KMEANS_ITERATIONS);
        let mut sums = vec![0.0; modes * controls_len];
        for (residual, &label) in residuals.chunks_exact(controls_len).zip(&clusters.labels) {
            let share = 1.0 / clusters.sizes[label as usize].max(1) as f32;
            let sum = &mut sums[label as usize * controls_len..][..controls_len];
            sum.iter_mut().zip(residual).for_each(|(sum, value)| *sum += value * share);
        }
        let mut order: Vec<usize> = (0..modes).collect();
        order.sort_by_key(|&mode| std::cmp::Reverse(clusters.sizes[mode]));
        order.iter().flat_map(|&mode| &sums[mode * controls_len..][..controls_len]).copied().collect()
    }
}

/// The entry nearest to where one is missing, the first of equals.
fn nearest<T>(entries: &[Option<T>], distance: impl Fn(usize) -> usize) -> Option<&T> {
    (0..entries.len()).filter(|&i| entries[i].is_some()).min_by_key(|&i| distance(i)).and_then(|i| entries[i].as_ref())
}

/// How far apart two bins are: a step of acceleration or yaw rate is nearer than one of speed.
fn bin_distance(a: usize, b: usize) -> usize {
    let per_speed = binning::BINS / binning::SPEED_BINS;
    let turn_or_accel = |bin: usize| ((bin % per_speed) / 3, bin % 3);
    let ((accel_a, turn_a), (accel_b, turn_b)) = (turn_or_accel(a), turn_or_accel(b));
    4 * (a / per_speed).abs_diff(b / per_speed) + 2 * turn_a.abs_diff(turn_b) + accel_a.abs_diff(accel_b)
}

/// Coefficients `[features × controls]` that minimise ‖X W − Y‖² + λ‖W‖².
fn ridge_regression(samples: &[&Sample], controls_len: usize) -> Vec<f32> {
    let mut normal = SMatrix::<f64, { binning::FEATURES }, { binning::FEATURES }>::identity() * RIDGE;
    let mut target = DMatrix::<f64>::zeros(binning::FEATURES, controls_len);
    for sample in samples {
        for (i, &a) in sample.features.iter().enumerate() {
            for (j, &b) in sample.features.iter().enumerate() {
                normal[(i, j)] += f64::from(a) * f64::from(b);
            }
            for (j, control) in sample.controls.iter().flatten().enumerate() {
                target[(i, j)] += f64::from(a) * f64::from(*control);
            }
        }
    }
    match normal.cholesky() {
        Some(cholesky) => {
            let solution = cholesky.solve(&target);
            (0..binning::FEATURES)
                .flat_map(|i| (0..controls_len).map(move |j| (i, j)))
                .map(|at| solution[at] as f32)
                .collect()
        }
        None => vec![0.0; binning::FEATURES * controls_len],
    }
}
