//! Fits ridge and anchors to windows.

use std::sync::Arc;

use faer::linalg::solvers::Solve as _;
use faer::{Mat, Scale, Side};
use metrics::kmeans;
use nn::{Displacement, ModelConfig, base as binning};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use scene::AgentType;

use super::tables::{Bins, Features, TypeBase, describe};
use super::targets::{self, Controls, Driver};
use crate::TrainError;
use crate::agent_view::{AgentView, start};
use crate::samples::Agent;
use crate::view;

/// Penalty on the squared ridge coefficients.
const RIDGE: f64 = 1.0;
/// A bin with fewer windows takes the coefficients of the nearest other bin.
const RIDGE_WINDOWS_MIN: usize = 300;
/// A bin with fewer windows takes the anchors of the nearest other bin.
const WINDOWS_MIN: usize = 60;
/// Maximum change of speed, m/s²: a recorded future that exceeds it has a jump in its annotation.
const ACCELERATION_MAX_MPS2: f32 = 9.0;
/// A future is left out of the fit if the error of its best controls exceeds this, m.
const FIT_ERROR_MAX_M: f32 = 0.5;
/// A bin with this many windows needs no augmented windows at other scales.
const RECORDED_ENOUGH: usize = 2000;
const KMEANS_ITERATIONS: usize = 30;
/// Windows per bin that the clustering uses.
const CLUSTERED_MAX: usize = 4000;

/// The motion of an agent as the fit inverts it.
enum Motion {
    Bicycle(Driver),
    /// Displacements beyond constant velocity.
    Displacements {
        velocity_mps: [f32; 2],
        dt_s: f32,
    },
}

impl Motion {
    fn positions(&self, controls: &[[f32; 2]]) -> Vec<[f32; 2]> {
        match self {
            Self::Bicycle(driver) => driver.positions(controls),
            Self::Displacements { velocity_mps, dt_s } => targets::displaced(*velocity_mps, controls, *dt_s),
        }
    }

    fn controls(&self, truth: &[[f32; 2]]) -> Controls {
        match self {
            Self::Bicycle(driver) => driver.controls(truth),
            Self::Displacements { velocity_mps, dt_s } => targets::displacements(*velocity_mps, truth, *dt_s),
        }
    }
}

/// Augmentation: further windows that are fitted with each recorded one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Augmentation {
    /// Vehicles with noisy histories.
    pub(crate) noise: bool,
    /// Share of the vehicles whose motion is also shown as differences of positions.
    pub(crate) differenced: f64,
    /// Pedestrians at other scales: standard deviation of the logarithm of the scale. Few pedestrians walk
    /// fast, and they walk like the others. In bins of frequent speeds, anchors use the recorded scale only,
    /// see [`RECORDED_ENOUGH`].
    pub(crate) scale_deviation: f32,
    /// Share of the fast vehicles that are also shown at a larger scale.
    pub(crate) faster: f64,
}

impl Augmentation {
    /// The augmented windows of a view, and whether they are scaled. Cyclists and pedestrians keep to neither
    /// side of the road, so their augmented windows include the `mirrored` one.
    fn of(
        self,
        view: &AgentView,
        mirrored: Option<AgentView>,
        dt_s: f64,
        random: &mut impl Rng,
    ) -> Vec<(AgentView, bool)> {
        match view.agent.agent_type {
            AgentType::Vehicle => {
                let noisy = self.noise.then(|| (view::noisy(view.clone(), random), false));
                let is_differenced = random.random_bool(self.differenced);
                let differenced = is_differenced.then(|| (view::differenced(view.clone(), dt_s), false));
                let faster = (view::is_fast(&view.agent) && random.random_bool(self.faster)).then(|| {
                    let mut view = view.clone();
                    view.scale(view::faster_scale(random));
                    (view, false)
                });
                noisy.into_iter().chain(differenced).chain(faster).collect()
            }
            AgentType::Pedestrian if self.scale_deviation > 0.0 => {
                let scaled = [Some(view.clone()), mirrored.clone()].into_iter().flatten().map(|mut view| {
                    let deviation: f32 = StandardNormal.sample(random);
                    view.scale((deviation * self.scale_deviation).exp());
                    (view, true)
                });
                scaled.chain(mirrored.clone().map(|view| (view, false))).collect()
            }
            AgentType::Cyclist | AgentType::Pedestrian => {
                mirrored.into_iter().map(|view| (view, false)).collect()
            }
        }
    }
}

/// A window in the form that the fit uses.
pub(super) struct Sample {
    /// Whether its scale differs from the recorded one.
    scaled: bool,
    bins: Bins,
    features: Features,
    motion: Motion,
    /// Recorded positions in the agent frame, m.
    truth: Vec<[f32; 2]>,
    /// The controls that lead through these positions.
    controls: Controls,
}

impl Sample {
    /// The window with its whole history, the same window cut to the shorter classes if the history is long
    /// enough, and their augmented windows.
    pub(super) fn of_every_class(
        agent: &Arc<Agent>,
        config: &ModelConfig,
        cuts_mps: &[f32],
        augmentation: Augmentation,
        random: &mut impl Rng,
    ) -> Vec<Self> {
        let present = agent.history.iter().rev().take_while(|state| state.is_some()).count();
        let lens =
            [2, 3, config.history_len].into_iter().filter(|&len| len <= present || len == config.history_len);
        let mut samples = Vec::new();
        for len in lens {
            let Some(view) = view::shown(agent, len, false) else { continue };
            let augmented = augmentation.of(&view, view::shown(agent, len, true), config.dt_s, random);
            let views = std::iter::once((view, false)).chain(augmented);
            let sample = |(view, scaled): (AgentView, bool)| {
                Some(Self { scaled, ..Self::new(&view, config, cuts_mps)? })
            };
            samples.extend(views.filter_map(sample));
        }
        samples
    }

    fn new(view: &AgentView, config: &ModelConfig, cuts_mps: &[f32]) -> Option<Self> {
        let AgentView { agent, history, frame, .. } = view;
        let truth: Vec<[f32; 2]> = view.truth().collect::<Option<_>>()?;
        let newest = history.last().copied().flatten()?;
        let dt_s = config.dt_s as f32;
        let velocity_mps = frame.rotate_into(newest.velocity_mps);
        if jumps(velocity_mps, &truth, dt_s) {
            return None;
        }
        let motion = match config.displacement {
            _ if config.drives(agent.agent_type) => {
                Motion::Bicycle(Driver::new(&start(agent, history, frame, config), config))
            }
            Displacement::Residual => Motion::Displacements { velocity_mps, dt_s },
            Displacement::Absolute => Motion::Displacements { velocity_mps: [0.0; 2], dt_s },
        };
        let (features, bins) = describe(history, frame, cuts_mps, config);
        let controls = motion.controls(&truth);
        if mean_distance_m(&motion.positions(&controls), &truth) > FIT_ERROR_MAX_M {
            return None;
        }
        Some(Self { scaled: false, bins, features, motion, truth, controls })
    }
}

/// Mean distance between two trajectories, m.
fn mean_distance_m(a: &[[f32; 2]], b: &[[f32; 2]]) -> f32 {
    let distances = a.iter().zip(b).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    distances.sum::<f32>() / a.len().max(1) as f32
}

/// Whether positions (agent frame) after a velocity need accelerations beyond [`ACCELERATION_MAX_MPS2`].
fn jumps(velocity_mps: [f32; 2], positions: &[[f32; 2]], dt_s: f32) -> bool {
    let mut before = ([0.0; 2], velocity_mps);
    positions.iter().any(|&position| {
        let velocity = [0, 1].map(|axis| (position[axis] - before.0[axis]) / dt_s);
        let change = (velocity[0] - before.1[0]).hypot(velocity[1] - before.1[1]);
        before = (position, velocity);
        change > ACCELERATION_MAX_MPS2 * dt_s
    })
}

impl TypeBase {
    /// Fills the tables from windows.
    ///
    /// For pedestrians the ridge is constant velocity, because the mean of their motion is no better. Their
    /// accelerations and yaw rates are mostly noise, so they have one set of anchors per speed bin.
    pub(super) fn fit(
        &mut self,
        agent_type: AgentType,
        samples: &[Sample],
        config: &ModelConfig,
        seed: u64,
    ) -> Result<(), TrainError> {
        let control_count = 2 * config.horizon_len;
        let walks = agent_type == AgentType::Pedestrian;
        if !walks {
            self.fit_ridge(samples, control_count)?;
        }
        self.fit_anchors(samples, config.modes, control_count, (walks, seed));
        self.fit_support(samples);
        Ok(())
    }

    /// Sets the bounds of every feature to its extremes over the windows of a history class.
    pub(super) fn fit_support(&mut self, samples: &[Sample]) {
        let Some(support) = &mut self.support else { return };
        for (class, bounds) in support.chunks_exact_mut(binning::FEATURES).enumerate() {
            for (feature, bounds) in bounds.iter_mut().enumerate() {
                let of_class = samples.iter().filter(|sample| sample.bins.class == class);
                let values = of_class.map(|sample| sample.features[feature]);
                let all = values.fold(None, |all: Option<[f32; 2]>, x| {
                    Some(all.map_or([x; 2], |[least, most]| [least.min(x), most.max(x)]))
                });
                *bounds = all.unwrap_or(*bounds);
            }
        }
    }

    fn fit_ridge(&mut self, samples: &[Sample], control_count: usize) -> Result<(), TrainError> {
        let per_bin = binning::FEATURES * control_count;
        for class in 0..binning::CLASSES {
            let of_class: Vec<&Sample> = samples.iter().filter(|sample| sample.bins.class == class).collect();
            let own = (0..binning::SPEED_BINS).map(|bin| {
                let of_bin = of_class.iter().copied().filter(|sample| sample.bins.speed_bin == bin);
                let of_bin: Vec<&Sample> = of_bin.collect();
                let is_enough = of_bin.len() >= RIDGE_WINDOWS_MIN;
                is_enough.then(|| ridge_regression(&of_bin, control_count)).transpose()
            });
            let own = own.collect::<Result<Vec<_>, _>>()?;
            let pooled = match own.iter().any(Option::is_some) {
                true => None,
                false => Some(ridge_regression(&of_class, control_count)?),
            };
            for bin in 0..binning::SPEED_BINS {
                let of_bin = own[bin].as_ref().or_else(|| nearest(&own, |other| bin.abs_diff(other)));
                if let Some(solution) = of_bin.or(pooled.as_ref()) {
                    self.ridge[(class * binning::SPEED_BINS + bin) * per_bin..][..per_bin]
                        .copy_from_slice(solution);
                }
            }
        }
        Ok(())
    }

    fn fit_anchors(
        &mut self,
        samples: &[Sample],
        modes: usize,
        control_count: usize,
        (by_speed_alone, seed): (bool, u64),
    ) {
        let longest = samples.iter().filter(|sample| sample.bins.class + 1 == binning::CLASSES);
        let per_speed = binning::BINS / binning::SPEED_BINS;
        let mut by_bin: Vec<Vec<&Sample>> = vec![Vec::new(); binning::BINS];
        longest.for_each(|sample| {
            let bin = sample.bins.bin;
            by_bin[if by_speed_alone { bin / per_speed * per_speed } else { bin }].push(sample);
        });
        for of_bin in &mut by_bin {
            if of_bin.iter().filter(|sample| !sample.scaled).count() >= RECORDED_ENOUGH {
                of_bin.retain(|sample| !sample.scaled);
            }
        }
        let own: Vec<Option<Vec<f32>>> = by_bin
            .iter()
            .map(|of_bin| {
                (of_bin.len() >= WINDOWS_MIN).then(|| self.cluster(of_bin, modes, control_count, seed))
            })
            .collect();
        let all: Vec<&Sample> = by_bin.iter().flatten().copied().collect();
        let pooled = (all.len() >= modes).then(|| self.cluster(&all, modes, control_count, seed));
        let per_bin = (modes + 1) * control_count;
        for bin in 0..binning::BINS {
            let own_bin = if by_speed_alone { bin / per_speed * per_speed } else { bin };
            let anchors = own[own_bin].as_ref().or_else(|| nearest(&own, |other| bin_distance(bin, other)));
            if let Some(anchors) = anchors.or(pooled.as_ref()) {
                self.anchors[bin * per_bin..][..modes * control_count].copy_from_slice(anchors);
            }
        }
    }

    /// Mean control residuals of the clusters of position residuals, `[modes × controls]`, largest cluster
    /// first.
    fn cluster(&self, samples: &[&Sample], modes: usize, control_count: usize, seed: u64) -> Vec<f32> {
        let stride = samples.len().div_ceil(CLUSTERED_MAX);
        let samples: Vec<&Sample> = samples.iter().copied().step_by(stride).collect();
        let mut positions = Vec::with_capacity(samples.len() * control_count);
        let mut residuals = Vec::with_capacity(samples.len() * control_count);
        for sample in &samples {
            let ridge = self.ridge(&sample.features, sample.bins, control_count);
            let (ridge, _) = ridge.as_chunks::<2>();
            let forecast = sample.motion.positions(ridge);
            positions
                .extend(sample.truth.iter().flatten().zip(forecast.iter().flatten()).map(|(t, f)| t - f));
            residuals
                .extend(sample.controls.iter().flatten().zip(ridge.iter().flatten()).map(|(c, r)| c - r));
        }
        let clusters = kmeans(&positions, control_count, modes, seed, KMEANS_ITERATIONS);
        let mut sums = vec![0.0; modes * control_count];
        for (residual, &label) in residuals.chunks_exact(control_count).zip(&clusters.labels) {
            let share = 1.0 / clusters.sizes[label as usize].max(1) as f32;
            let sum = &mut sums[label as usize * control_count..][..control_count];
            sum.iter_mut().zip(residual).for_each(|(sum, value)| *sum += value * share);
        }
        let mut order: Vec<usize> = (0..modes).collect();
        order.sort_by_key(|&mode| std::cmp::Reverse(clusters.sizes[mode]));
        order.iter().flat_map(|&mode| &sums[mode * control_count..][..control_count]).copied().collect()
    }
}

/// The present entry nearest to an absent one; the first one if several are equally near.
fn nearest<T>(entries: &[Option<T>], distance: impl Fn(usize) -> usize) -> Option<&T> {
    (0..entries.len())
        .filter(|&i| entries[i].is_some())
        .min_by_key(|&i| distance(i))
        .and_then(|i| entries[i].as_ref())
}

/// Distance between two bins. A step of acceleration or yaw rate counts less than a step of speed.
fn bin_distance(a: usize, b: usize) -> usize {
    let per_speed = binning::BINS / binning::SPEED_BINS;
    let turn_or_accel = |bin: usize| ((bin % per_speed) / 3, bin % 3);
    let ((accel_a, turn_a), (accel_b, turn_b)) = (turn_or_accel(a), turn_or_accel(b));
    4 * (a / per_speed).abs_diff(b / per_speed) + 2 * turn_a.abs_diff(turn_b) + accel_a.abs_diff(accel_b)
}

/// Coefficients W `[features × controls]` that minimise ‖X W − Y‖² + λ‖W‖², by the normal equations (XᵀX +
/// λI) W = XᵀY.
fn ridge_regression(samples: &[&Sample], control_count: usize) -> Result<Vec<f32>, TrainError> {
    let features = Mat::from_fn(samples.len(), binning::FEATURES, |i, j| f64::from(samples[i].features[j]));
    let controls =
        Mat::from_fn(samples.len(), control_count, |i, j| f64::from(samples[i].controls[j / 2][j % 2]));
    let penalty = Scale(RIDGE) * Mat::<f64>::identity(binning::FEATURES, binning::FEATURES);
    let normal = features.transpose() * &features + penalty;
    let factor = normal.llt(Side::Lower).map_err(|_| TrainError::Fit { windows: samples.len() })?;
    let solution = factor.solve(features.transpose() * &controls);
    let rows = (0..binning::FEATURES).flat_map(|i| (0..control_count).map(move |j| (i, j)));
    Ok(rows.map(|at| solution[at] as f32).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window with these features. Its control is a linear function of the first two.
    fn sample(first: f32, second: f32) -> Sample {
        let mut features = [0.0; binning::FEATURES];
        (features[0], features[1]) = (first, second);
        Sample {
            scaled: false,
            bins: Bins { class: 0, speed_bin: 0, bin: 0 },
            features,
            motion: Motion::Displacements { velocity_mps: [0.0; 2], dt_s: 0.4 },
            truth: Vec::new(),
            controls: vec![[2.0 * first - second, 0.5 * second]],
        }
    }

    #[test]
    fn the_ridge_finds_a_linear_function() {
        let samples: Vec<Sample> =
            (0..4_000).map(|i| sample((i % 17) as f32 - 8.0, (i % 23) as f32 - 11.0)).collect();
        let found = ridge_regression(&samples.iter().collect::<Vec<_>>(), 2).unwrap();
        let mut expected = vec![0.0; 2 * binning::FEATURES];
        expected[..4].copy_from_slice(&[2.0, 0.0, -1.0, 0.5]);
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-3, "{found} for {expected}");
        }
    }

    #[test]
    fn a_feature_that_is_not_finite_fails_the_fit() {
        let samples = [sample(1.0, 2.0), sample(f32::NAN, 1.0)];
        let error = ridge_regression(&samples.iter().collect::<Vec<_>>(), 2).unwrap_err();
        assert!(matches!(error, TrainError::Fit { windows: 2 }), "{error}");
    }
}
