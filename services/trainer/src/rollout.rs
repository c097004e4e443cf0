//! From encodings and latent variables to trajectories, type by type.

use std::ops::Range;

use burn::tensor::Tensor;
use nn::ModelConfig;

use crate::batch::{Batch, integers};
use crate::model::{Controls, Decoder, Encoded, LATENT, TYPE_NAMES};
use crate::motion::{self, VehicleStart};
use crate::parameters::Weights;

/// The agents of one type in a batch, encoded and ready to be forecast.
pub(crate) struct TypeForecast<'a> {
    config: &'a ModelConfig,
    batch: &'a Batch,
    weights: &'a Weights,
    decoder: Decoder<'a>,
    pub(crate) agent_type: usize,
    pub(crate) agents: Range<usize>,
    /// ṽ `[agents, 64]`.
    pub(crate) encoding: Tensor<2>,
    /// Hidden state after the history `[agents, 128]`.
    pub(crate) hidden: Tensor<2>,
}

/// Trajectories of every agent of a type and draw.
pub(crate) struct Rollout {
    /// Gaussians of the controls without the base.
    pub(crate) controls: Controls,
    /// Mean of the controls with the base, before saturation `[agents × draws, horizon, 2]`.
    pub(crate) mean: Tensor<3>,
    /// Positions in agent frames `[agents × draws, horizon, 2]`.
    pub(crate) positions: Tensor<3>,
}

impl<'a> TypeForecast<'a> {
    /// `None` where the batch has no agent of the type.
    pub(crate) fn new(
        weights: &'a Weights,
        config: &'a ModelConfig,
        batch: &'a Batch,
        encoded: &Encoded,
        agent_type: usize,
    ) -> Option<Self> {
        let agents = batch.type_agents[agent_type].clone();
        if agents.is_empty() {
            return None;
        }
        let decoder = Decoder::new(weights, TYPE_NAMES[agent_type]);
        let encoding = encoded.summary.encoding.clone().slice([agents.clone()]);
        let present = batch.present.clone().slice([agents.clone()]);
        let hidden = decoder.burn_in(&batch.state.clone().slice([agents.clone()]), &present);
        Some(Self { config, batch, weights, decoder, agent_type, agents, encoding, hidden })
    }

    /// The same agents, decoded by `weights`, without gradients.
    pub(crate) fn frozen<'b>(&'b self, weights: &'b Weights) -> TypeForecast<'b> {
        TypeForecast {
            config: self.config,
            batch: self.batch,
            weights,
            decoder: Decoder::new(weights, TYPE_NAMES[self.agent_type]),
            agent_type: self.agent_type,
            agents: self.agents.clone(),
            encoding: self.encoding.clone().inner(),
            hidden: self.hidden.clone().inner(),
        }
    }

    /// Mode logits `[agents, modes]`; their gradient stops at the encoding.
    pub(crate) fn mode_logits(&self) -> Tensor<2> {
        self.decoder.mode_logits(self.encoding.clone().detach(), self.hidden.clone().detach())
    }

    /// Forecasts by learned points: `modes` holds `draws_len` numbers per agent, [`ModelConfig::modes`] being the point
    /// of the single best forecast, which has no anchor.
    pub(crate) fn by_points(&self, modes: &[usize], draws_len: usize) -> Rollout {
        let name = format!("decoder.{}", TYPE_NAMES[self.agent_type]);
        let mut points = self.weights.get::<2>(&format!("{name}.latents"));
        if self.config.best_latent {
            let best = self.weights.get::<1>(&format!("{name}.latent_best"));
            points = Tensor::cat(vec![points, best.unsqueeze()], 0);
        }
        let device = points.device();
        let latent =
            points.select(0, integers(modes, &device)).reshape([self.agents.len(), draws_len, LATENT]);
        self.with_latent(latent, Some(self.base(modes, draws_len)))
    }

    /// Forecasts of the base control alone.
    pub(crate) fn by_base(&self, modes: &[usize], draws_len: usize) -> Tensor<3> {
        self.positions(self.base(modes, draws_len), draws_len)
    }

    /// Forecasts by latent variables `[agents, draws, 32]` and a base control `[agents × draws, horizon, 2]`.
    pub(crate) fn with_latent(&self, latent: Tensor<3>, base: Option<Tensor<3>>) -> Rollout {
        let draws_len = latent.dims()[1];
        let horizon_len = self.config.horizon_len;
        let controls = self.decoder.forward(&self.hidden, self.encoding.clone(), latent, horizon_len);
        let mean = base.map_or_else(|| controls.mean(), |base| controls.mean() + base);
        let positions = self.positions(mean.clone(), draws_len);
        Rollout { controls, mean, positions }
    }

    /// Positions under controls before saturation `[agents × draws, horizon, 2]`.
    pub(crate) fn positions(&self, controls: Tensor<3>, draws_len: usize) -> Tensor<3> {
        if self.agent_type == 0 {
            let start = repeated_start(&self.batch.start, draws_len);
            return motion::drive(self.config, &start, controls).narrow(2, 0, 2);
        }
        let velocity = self.batch.velocity_mps.clone().slice([self.agents.clone()]);
        motion::displace(self.config, &crate::model::repeat(velocity, draws_len), &controls)
    }

    /// True positions and what of them counts, repeated for every draw.
    pub(crate) fn truth(&self, draws_len: usize) -> (Tensor<3>, Tensor<2>) {
        let horizon_len = self.config.horizon_len;
        let truth = self
            .batch
            .truth
            .clone()
            .slice([self.agents.clone()])
            .reshape([self.agents.len(), horizon_len * 2]);
        let truth =
            crate::model::repeat(truth, draws_len).reshape([self.agents.len() * draws_len, horizon_len, 2]);
        let counts = crate::model::repeat(self.batch.counts.clone().slice([self.agents.clone()]), draws_len);
        (truth, counts)
    }

    fn base(&self, modes: &[usize], draws_len: usize) -> Tensor<3> {
        let horizon_len = self.config.horizon_len;
        let anchors_len = self.batch.anchors.dims()[1];
        let rows: Vec<usize> = modes
            .iter()
            .enumerate()
            .map(|(row, mode)| (self.agents.start + row / draws_len) * anchors_len + mode)
            .collect();
        let anchors = self.batch.anchors.clone();
        let anchors = anchors
            .reshape([-1, 2 * horizon_len as i64])
            .select(0, integers(&rows, &self.batch.ridge.device()));
        let ridge = self
            .batch
            .ridge
            .clone()
            .slice([self.agents.clone()])
            .reshape([self.agents.len(), 2 * horizon_len]);
        (crate::model::repeat(ridge, draws_len) + anchors).reshape([modes.len(), horizon_len, 2])
    }
}

fn repeated_start(start: &VehicleStart, times: usize) -> VehicleStart {
    let repeat = |values: &Tensor<2>| crate::model::repeat(values.clone(), times);
    VehicleStart {
        position_m: repeat(&start.position_m),
        heading_rad: repeat(&start.heading_rad),
        speed_mps: repeat(&start.speed_mps),
        slip_rad: repeat(&start.slip_rad),
        rear_axle_m: repeat(&start.rear_axle_m),
    }
}
