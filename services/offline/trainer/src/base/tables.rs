//! The tables of a type's base control.

use nn::{ModelConfig, base as binning, base::BaseFeatures, base::Support};
use scene::{AgentFrame, AgentType, FeatureScales, State, state_features};

pub(super) type Features = [f32; binning::FEATURES];

/// Bounds that contain every value of a feature, also in half precision.
pub(super) const EVERYWHERE: [f32; 2] = [-65504.0, 65504.0];

#[derive(Clone, Debug)]
pub(super) struct TypeBase {
    pub(super) speed_cuts_mps: [f32; binning::SPEED_BINS - 1],
    /// `[classes, speed bins, features, controls]`.
    pub(super) ridge: Vec<f32>,
    /// `[bins, modes + 1, controls]`; the last of each bin is zero, for the single best forecast.
    pub(super) anchors: Vec<f32>,
    /// `[classes, features]`: lower and upper bounds; `None` if the model has none.
    pub(super) support: Option<Vec<[f32; 2]>>,
}

impl TypeBase {
    pub(super) fn zero(config: &ModelConfig, agent_type: AgentType) -> Self {
        let control_count = 2 * config.horizon_len;
        Self {
            speed_cuts_mps: metrics::speed_cuts_mps(agent_type),
            ridge: vec![0.0; binning::CLASSES * binning::SPEED_BINS * binning::FEATURES * control_count],
            anchors: vec![0.0; binning::BINS * (config.modes + 1) * control_count],
            support: config.base_support.then(|| vec![EVERYWHERE; binning::CLASSES * binning::FEATURES]),
        }
    }

    /// The features clamped to the support, and their distance outside of it.
    pub(super) fn supported(&self, features: &Features, bins: Bins) -> (Features, f32) {
        self.support.as_ref().map_or((*features, 0.0), |support| {
            Support::new(&support[bins.class * binning::FEATURES..]).clamp(features)
        })
    }

    pub(super) fn ridge(&self, features: &Features, bins: Bins, control_count: usize) -> Vec<f32> {
        let per_bin = binning::FEATURES * control_count;
        let table = &self.ridge[(bins.class * binning::SPEED_BINS + bins.speed_bin) * per_bin..][..per_bin];
        let mut controls = vec![0.0; control_count];
        for (feature, row) in features.iter().zip(table.chunks_exact(control_count)) {
            controls.iter_mut().zip(row).for_each(|(control, weight)| *control += feature * weight);
        }
        controls
    }
}

/// An agent's bins in the tables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bins {
    pub(super) class: usize,
    pub(super) speed_bin: usize,
    pub(super) bin: usize,
}

pub(super) fn describe(
    history: &[Option<State>],
    frame: &AgentFrame,
    cuts_mps: &[f32],
    config: &ModelConfig,
) -> (Features, Bins) {
    let scales = FeatureScales { position: config.position_scale, velocity: config.velocity_scale };
    let states: Vec<[f32; 6]> = history
        .iter()
        .map(|state| state.map_or([0.0; 6], |state| state_features(frame, &state, scales)))
        .collect();
    let features = BaseFeatures::new(&states, |step| history[step].is_some(), config);
    let bins = Bins {
        class: features.class,
        speed_bin: features.speed_bin(cuts_mps),
        bin: features.anchor_bin(cuts_mps),
    };
    (features.values, bins)
}
