use bytemuck::Zeroable;
use decoder::{Decoder, DecoderOptions, StartError};
use encoder::{Encoder, EncoderOptions};
use nn::Weights;
use wire::{AGENTS_MAX, AgentControls, AgentEncoding, Header, Rejected, StageId};

use crate::{FeatureFrame, Load};

/// Encoder and decoder. Their output for a tick does not depend on other ticks.
pub struct FeaturesToControls {
    encoder: Encoder,
    decoder: Decoder,
    horizon_len: u32,
    modes_len: u32,
    encodings: Vec<AgentEncoding>,
    encodings_len: usize,
    controls: Vec<AgentControls>,
}

/// The encodings of a tick's agents and the controls of those that are forecast.
#[derive(Clone, Copy, Debug)]
pub struct Controls<'a> {
    /// All agents of the frame.
    pub encodings: &'a [AgentEncoding],
    /// The agents that are forecast, in their order.
    pub controls: &'a [AgentControls],
}

impl FeaturesToControls {
    /// Stages with the model's networks.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not contain the model or a thread can't be started.
    pub fn new(
        weights: &Weights,
        encoder: EncoderOptions,
        decoder: DecoderOptions,
    ) -> Result<Self, StartError> {
        let model = weights.config();
        Ok(Self {
            horizon_len: model.horizon_len as u32,
            modes_len: model.modes as u32,
            encoder: Encoder::new(weights, encoder)?,
            decoder: Decoder::new(weights, decoder)?,
            encodings: vec![AgentEncoding::zeroed(); AGENTS_MAX],
            encodings_len: 0,
            controls: vec![AgentControls::zeroed(); AGENTS_MAX],
        })
    }

    /// Takes the features of a tick to controls; `passed` is called after each stage. Without features there
    /// are no controls.
    ///
    /// # Errors
    /// [`Rejected`] if a stage refuses the tick.
    pub fn step(
        &mut self,
        frame: &FeatureFrame,
        mut passed: impl FnMut(StageId),
    ) -> Result<Controls<'_>, Rejected> {
        let Some(features) = frame.features() else { return Ok(Controls { encodings: &[], controls: &[] }) };
        let (features, mut header): (_, Header) = (features?, *frame.header());
        self.encodings_len = frame.agents_len();
        let encodings = &mut self.encodings[..self.encodings_len];
        self.encoder.step(&header, &features, encodings)?;
        passed(StageId::Encoder);

        let controls = &mut self.controls[..Decoder::len(encodings)];
        header.counts.agents_len = controls.len() as u32;
        header.counts.horizon_len = self.horizon_len;
        header.counts.modes_len = self.modes_len;
        self.decoder.step(&header, encodings, controls)?;
        passed(StageId::Decoder);
        Ok(Controls { encodings, controls })
    }

    /// Number of steps of the model's horizon, and number of its modes.
    pub(crate) const fn lens(&self) -> (u32, u32) {
        (self.horizon_len, self.modes_len)
    }

    /// The size of the last tick.
    #[must_use]
    pub fn load(&self, frame: &FeatureFrame) -> Load {
        let Some(Ok(features)) = frame.features() else { return Load::default() };
        Load::of(&features, &self.encodings[..self.encodings_len], frame.header().counts.history_len)
    }
}
