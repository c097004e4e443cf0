//! The base control B*: a linear function of the newest steps, plus one anchor per mode.
//!
//! A *ridge* regression per history class and speed bin predicts the control sequence from 26 features of the
//! last four steps. *Anchors* are typical residuals of that prediction, one set per bin of speed,
//! acceleration and yaw rate. The network's output is the remaining residual:
//!
//! ```text
//! control of mode m at step t = ridge(features)\[t\] + anchors\[bin\]\[m\]\[t\] + μ\[m\]\[t\]
//! ```
//!
//! The best forecast has no anchor.
//!
//! A base with *support* has a lower and an upper bound per history class and feature. All windows of its fit
//! are within these bounds. Features are clamped to them. With the distance of the farthest feature from its
//! bounds, the ridge and the network's output shrink to zero control, and only the anchors remain:
//!
//! ```text
//! e = max |x − clamp(x)| / (upper − lower)
//! control of mode m at step t = (ridge(clamp(x))\[t\] + μ\[m\]\[t\]) / (1 + (e / 0.25)²) + anchors\[bin\]\[m\]\[t\]
//! ```

use std::f32::consts::{PI, TAU};

use wire::{AgentType, STATE_FEATURES};

use crate::ModelConfig;
use crate::weights::{Weights, WeightsError};

/// Features of the ridge regression.
pub const FEATURES: usize = 26;
/// Newest steps that the features use.
pub const STEPS: usize = 4;
/// Classes of histories: 2, 3, or at least 4 newest consecutive steps.
pub const CLASSES: usize = 3;
/// Bins of the speed.
pub const SPEED_BINS: usize = 8;
/// Bins of speed, acceleration and yaw rate.
pub const BINS: usize = SPEED_BINS * 9;
/// Distance from the support, relative to its width, at which half of the controls is kept.
pub const HALF_SUPPORT: f32 = 0.25;
/// Index of the acceleration over the last step among the features, m/s².
pub const ACCELERATION: usize = 19;
/// Index of |ω| v among the features, m/s².
pub const LATERAL_ACCELERATION: usize = 22;
/// Index of v² among the features, (m/s)².
pub const SPEED_SQUARED: usize = 23;
/// Boundaries of the acceleration bins, m/s².
const ACCEL_CUTS_MPS2: [f32; 2] = [-0.7, 0.5];
/// Boundaries of the yaw-rate bins, rad/s.
const YAW_RATE_CUTS_RADPS: [f32; 2] = [-0.06, 0.06];

/// The inputs of the base control from a history, in metres and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseFeatures {
    /// The inputs of the ridge regression.
    pub values: [f32; FEATURES],
    /// Class of the history, below [`CLASSES`].
    pub class: usize,
    /// Speed at the last step.
    pub speed_mps: f32,
    /// Change of speed over the last step.
    pub accel_mps2: f32,
    /// Change of heading over the last step.
    pub yaw_rate_radps: f32,
}

/// A step in metres and seconds.
#[derive(Clone, Copy)]
struct Step {
    position_m: [f32; 2],
    velocity_mps: [f32; 2],
    speed_mps: f32,
    heading_rad: f32,
}

/// The equivalent angle within half a turn of 0.
fn wrap(angle_rad: f32) -> f32 {
    let turns = ((angle_rad + PI) / TAU).floor();
    angle_rad - turns * TAU
}

impl BaseFeatures {
    /// The features of a history of state features s, oldest first, in the model's scale.
    ///
    /// ```text
    /// positions of steps 1-3 · velocities of steps 1-4 · headings of steps 1-3 relative to step 4
    /// v ω₁, v ω₂, a₁, a₂, v² ω₁, v |ω₁|, v², v min(a₁, 0) · 1
    /// ```
    ///
    /// Step 4 is the newest and v its speed. ω₁ and a₁ are the changes of heading and speed over the last
    /// step, ω₂ and a₂ over the previous one. Missing steps, steps before a missing one, and all values that
    /// depend on them are 0.
    #[must_use]
    pub fn new(
        states: &[[f32; STATE_FEATURES]],
        present: impl Fn(usize) -> bool,
        config: &ModelConfig,
    ) -> Self {
        let mut steps = [None; STEPS];
        for back in 0..STEPS.min(states.len()) {
            let step = states.len() - 1 - back;
            if !present(step) {
                break;
            }
            steps[STEPS - 1 - back] = Some(Step::new(&states[step], config));
        }
        let rows = steps.iter().flatten().count();
        let change = |newer: Option<Step>, older: Option<Step>| match (newer, older) {
            (Some(newer), Some(older)) => {
                let dt_s = config.dt_s as f32;
                let turn_rad = wrap(newer.heading_rad - older.heading_rad);
                [turn_rad / dt_s, (newer.speed_mps - older.speed_mps) / dt_s]
            }
            _ => [0.0; 2],
        };
        let [_, second, third, newest] = steps;
        let [yaw_rate, accel] = change(newest, third);
        let [yaw_rate_before, accel_before] = change(third, second);
        let speed = newest.map_or(0.0, |step| step.speed_mps);
        let mut values = [0.0; FEATURES];
        for (i, step) in steps.iter().enumerate() {
            let Some(step) = step else { continue };
            if i < STEPS - 1 {
                values[2 * i..2 * i + 2].copy_from_slice(&step.position_m);
                let newest_rad = newest.map_or(0.0, |newest| newest.heading_rad);
                values[14 + i] = wrap(step.heading_rad - newest_rad);
            }
            values[6 + 2 * i..8 + 2 * i].copy_from_slice(&step.velocity_mps);
        }
        values[17..].copy_from_slice(&[
            speed * yaw_rate,
            speed * yaw_rate_before,
            accel,
            accel_before,
            speed * speed * yaw_rate,
            yaw_rate.abs() * speed,
            speed * speed,
            accel.min(0.0) * speed,
            1.0,
        ]);
        Self {
            values,
            class: rows.clamp(2, STEPS) - 2,
            speed_mps: speed,
            accel_mps2: accel,
            yaw_rate_radps: yaw_rate,
        }
    }

    /// The bin of the speed, given the boundaries of the bins.
    #[must_use]
    pub fn speed_bin(&self, cuts_mps: &[f32]) -> usize {
        bin(self.speed_mps, cuts_mps)
    }

    /// The bin of speed, acceleration and yaw rate, below [`BINS`].
    #[must_use]
    pub fn anchor_bin(&self, speed_cuts_mps: &[f32]) -> usize {
        let accel = bin(self.accel_mps2, &ACCEL_CUTS_MPS2);
        let yaw_rate = bin(self.yaw_rate_radps, &YAW_RATE_CUTS_RADPS);
        (self.speed_bin(speed_cuts_mps) * 3 + accel) * 3 + yaw_rate
    }
}

fn bin(value: f32, cuts: &[f32]) -> usize {
    cuts.iter().filter(|&&cut| value >= cut).count()
}

/// Bounds of the features in the base's fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Support {
    bounds: [[f32; 2]; FEATURES],
}

impl Support {
    /// The support with a lower and an upper bound per feature.
    ///
    /// # Panics
    /// If the number of bounds differs from the number of features.
    #[must_use]
    pub fn new(bounds: &[[f32; 2]]) -> Self {
        Self { bounds: std::array::from_fn(|feature| bounds[feature]) }
    }

    /// The features clamped to the bounds, and e: the distance of the farthest one from its bounds, relative
    /// to their width.
    #[must_use]
    pub fn clamp(&self, features: &[f32; FEATURES]) -> ([f32; FEATURES], f32) {
        let mut outside = 0.0_f32;
        let clamped = std::array::from_fn(|feature| {
            let (x, [lower, upper]) = (features[feature], self.bounds[feature]);
            let clamped = x.max(lower).min(upper);
            if clamped != x {
                outside = outside.max((x - clamped).abs() / (upper - lower).max(f32::MIN_POSITIVE));
            }
            clamped
        });
        (clamped, outside)
    }
}

/// The share of the controls that is kept at a distance e from the support.
#[must_use]
pub fn kept_share(outside: f32) -> f32 {
    1.0 / (1.0 + (outside / HALF_SUPPORT).powi(2))
}

impl Step {
    fn new(&[x, y, vx, vy, cos, sin]: &[f32; STATE_FEATURES], config: &ModelConfig) -> Self {
        let velocity_mps = [vx / config.velocity_scale, vy / config.velocity_scale];
        Self {
            position_m: [x / config.position_scale, y / config.position_scale],
            velocity_mps,
            speed_mps: velocity_mps[0].hypot(velocity_mps[1]),
            heading_rad: sin.atan2(cos),
        }
    }
}

/// Factors that scale the controls of a type to similar magnitudes, for latent points that depend on the
/// controls.
#[must_use]
pub fn latent_scale(config: &ModelConfig, agent_type: AgentType) -> [f32; 2] {
    if config.drives(agent_type) { [0.5, 5.0] } else { [3.0, 3.0] }
}

/// The base control of an agent type.
#[derive(Debug)]
pub struct Base {
    /// \[class, speed bin, feature, step, component\].
    ridge: Vec<f32>,
    /// \[bin, mode, step\].
    anchors: Vec<[f32; 2]>,
    speed_cuts_mps: Vec<f32>,
    /// \[class\]; `None` if the features have no bounds.
    support: Option<Vec<Support>>,
    horizon_len: usize,
    modes_len: usize,
}

impl Base {
    /// The tensors `base.{type}.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn read(weights: &Weights, agent_type: AgentType) -> Result<Self, WeightsError> {
        let ModelConfig { horizon_len, modes: modes_len, .. } = *weights.config();
        let name = |part: &str| format!("base.{}.{part}", agent_type.name());
        let ridge = weights.tensor(&name("ridge"), &[CLASSES, SPEED_BINS, FEATURES, 2 * horizon_len])?;
        let anchors = weights.tensor(&name("anchors"), &[BINS, modes_len, horizon_len, 2])?;
        let speed_cuts_mps = weights.tensor(&name("speed_cuts"), &[SPEED_BINS - 1])?;
        let support = match weights.config().base_support {
            true => {
                let bounds = weights.tensor(&name("support"), &[CLASSES, FEATURES, 2])?;
                Some(bounds.as_chunks().0.chunks_exact(FEATURES).map(Support::new).collect())
            }
            false => None,
        };
        Ok(Self {
            ridge: ridge.to_vec(),
            anchors: anchors.as_chunks().0.to_vec(),
            speed_cuts_mps: speed_cuts_mps.to_vec(),
            support,
            horizon_len,
            modes_len,
        })
    }

    /// The ridge regression's controls, one per step of the horizon.
    ///
    /// # Panics
    /// If `controls` is shorter than the horizon.
    pub fn ridge(&self, features: &BaseFeatures, controls: &mut [[f32; 2]]) {
        let row_len = 2 * self.horizon_len;
        let table = (features.class * SPEED_BINS + features.speed_bin(&self.speed_cuts_mps)) * FEATURES;
        let rows = self.ridge[table * row_len..].chunks_exact(row_len);
        let sums = controls[..self.horizon_len].as_flattened_mut();
        sums.fill(0.0);
        let (values, outside) = self.supported(features);
        for (x, row) in values.iter().zip(rows) {
            sums.iter_mut().zip(row).for_each(|(sum, w)| *sum += x * w);
        }
        if outside > 0.0 {
            let share = kept_share(outside);
            sums.iter_mut().for_each(|sum| *sum *= share);
        }
    }

    /// The clamped features, and their distance from the support.
    fn supported(&self, features: &BaseFeatures) -> ([f32; FEATURES], f32) {
        self.support
            .as_ref()
            .map_or((features.values, 0.0), |support| support[features.class].clamp(&features.values))
    }

    /// The distance e of the features from the support; 0 if the base has none.
    #[must_use]
    pub fn outside(&self, features: &BaseFeatures) -> f32 {
        self.supported(features).1
    }

    /// Number of the base's controls for an agent: one per step of each mode and of the best forecast.
    pub const fn control_count(&self) -> usize {
        (self.modes_len + 1) * self.horizon_len
    }

    /// The base controls, \[mode, step\]: first every mode's, then the best forecast's.
    ///
    /// # Panics
    /// If the length of `controls` differs from [`Base::control_count`].
    pub fn controls(&self, features: &BaseFeatures, controls: &mut [[f32; 2]]) {
        assert_eq!(controls.len(), self.control_count(), "a control per mode and step");
        let (modes, best) = controls.split_at_mut(self.modes_len * self.horizon_len);
        self.ridge(features, best);
        for (mode, controls) in modes.chunks_exact_mut(self.horizon_len).enumerate() {
            for (control, (ridge, anchor)) in
                controls.iter_mut().zip(best.iter().zip(self.anchor(features, mode)))
            {
                *control = [ridge[0] + anchor[0], ridge[1] + anchor[1]];
            }
        }
    }

    /// The anchor of a mode: one control residual per step.
    #[must_use]
    pub fn anchor(&self, features: &BaseFeatures, mode: usize) -> &[[f32; 2]] {
        let bin = features.anchor_bin(&self.speed_cuts_mps);
        &self.anchors[(bin * self.modes_len + mode) * self.horizon_len..][..self.horizon_len]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ModelConfig {
        let mut config = Weights::onboard().config().clone();
        (config.position_scale, config.velocity_scale, config.dt_s) = (0.1, 0.2, 0.4);
        config
    }

    /// A left turn with increasing speed, in the frame of the last step.
    fn turn(len: usize) -> Vec<[f32; STATE_FEATURES]> {
        let state = |back: usize| {
            let (heading, speed) = (-0.04 * back as f32, 6.0 - 0.2 * back as f32);
            let (sin, cos) = heading.sin_cos();
            [-0.24 * back as f32, 0.01, speed * cos * 0.2, speed * sin * 0.2, cos, sin]
        };
        (0..len).rev().map(state).collect()
    }

    #[test]
    fn a_turn_has_the_features_of_its_formula() {
        let f = BaseFeatures::new(&turn(6), |_| true, &config());
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} is not {b}");
        close(f.values[0], -7.2);
        close(f.values[12], 6.0);
        close(f.values[14], -0.12);
        close(f.values[17], 6.0 * 0.1);
        close(f.values[19], 0.5);
        close(f.values[23], 36.0);
        assert_eq!((f.values[24], f.values[25], f.class), (0.0, 1.0, 2));
        assert_eq!(f.anchor_bin(&[0.5, 1.5, 3.0, 4.5, 6.0, 7.5, 9.5]), (5 * 3 + 2) * 3 + 2);
    }

    #[test]
    fn steps_before_a_gap_have_no_effect() {
        let (states, config) = (turn(6), config());
        let gap = BaseFeatures::new(&states, |step| step != 3, &config);
        let short = BaseFeatures::new(&states[4..], |_| true, &config);
        assert_eq!(gap, short);
        assert_eq!(gap.class, 0);
        assert!(gap.values[..4].iter().chain(&gap.values[6..10]).all(|&x| x == 0.0));
    }

    #[test]
    fn features_within_the_support_keep_all_of_the_controls_and_others_less() {
        let support = Support::new(&[[-1.0, 3.0]; FEATURES]);
        let mut features = [0.5; FEATURES];
        assert_eq!(support.clamp(&features), (features, 0.0));
        assert_eq!(kept_share(0.0), 1.0);
        (features[3], features[4]) = (4.0, -2.0);
        let (clamped, outside) = support.clamp(&features);
        assert_eq!((clamped[3], clamped[4], outside), (3.0, -1.0, 0.25));
        assert_eq!(kept_share(outside), 0.5);
        features[0] = 103.0;
        assert!(kept_share(support.clamp(&features).1) < 1e-3);
    }

    #[test]
    fn angles_are_wrapped_to_half_a_turn() {
        for angle in [-9.0_f32, -3.2, -0.1, 0.0, 3.1, 3.2, 12.0] {
            assert!(wrap(angle).abs() <= PI + 1e-6);
            assert!((wrap(angle).sin() - angle.sin()).abs() < 1e-5);
        }
    }
}
