//! Baseline B*: the decoder without its network, with the base controls only.

use nn::base::BaseFeatures;
use nn::{ModelConfig, Weights, WeightsError};
use wire::{AgentControls, AgentEncoding, AgentType, ControlGaussian};

/// The base controls of a model: a ridge regression and the anchors around its result.
pub struct BaseDecoder {
    networks: nn::Decoder,
    config: ModelConfig,
    /// \[mode, step\]. The last row holds the controls of the best forecast.
    controls: Vec<[f32; 2]>,
}

impl BaseDecoder {
    /// The base controls of a model; `None` if the model has none.
    ///
    /// # Errors
    /// [`WeightsError`] if the weights do not hold the model.
    pub fn new(weights: &Weights) -> Result<Option<Self>, WeightsError> {
        let config = weights.config().clone();
        config.check_frames()?;
        if !config.base {
            return Ok(None);
        }
        Ok(Some(Self { networks: nn::Decoder::new(weights)?, config, controls: Vec::new() }))
    }

    /// The base controls of an agent, without variance. All modes are equally probable.
    ///
    /// # Panics
    /// If the agent's type is invalid. The caller must check encodings first.
    pub fn controls(&mut self, agent: &AgentEncoding) -> AgentControls {
        let agent_type = AgentType::try_from(agent.agent_type).expect("the encoding's type was checked");
        let base = self.networks.of(agent_type).base().expect("a model with base controls");
        let features = BaseFeatures::new(
            &agent.state[..self.config.history_len],
            |step| agent.is_present(step),
            &self.config,
        );
        self.controls.resize(base.control_count(), [0.0; 2]);
        base.controls(&features, &mut self.controls);

        let ModelConfig { modes: modes_len, horizon_len, .. } = self.config;
        let mut out = AgentControls {
            modes_len: modes_len as u32,
            out_of_distribution: base.outside(&features),
            ..AgentControls::of(agent)
        };
        out.probability[..modes_len].fill(1.0 / modes_len as f32);
        let all = out.modes[..modes_len].iter_mut().chain([&mut out.best]);
        for (steps, means) in all.zip(self.controls.chunks_exact(horizon_len)) {
            for (control, &mean) in steps.iter_mut().zip(means) {
                *control = ControlGaussian { mean, ..ControlGaussian::default() };
            }
        }
        let (_, best) = self.controls.split_at(modes_len * horizon_len);
        out.base[..horizon_len].copy_from_slice(best);
        out
    }
}
