//! From encodings and latent variables to trajectories, type by type. \[model §3, §4\]
//!
//! **In:** ṽ `[agents, 64]`, latent variables `[agents × draws, 32]` and base controls. **Out:** controls
//! before saturation and positions in agent frames (m), `[agents × draws, horizon × 2]`.

use std::ops::Range;

use nn::ModelConfig;
use wire::{AGENT_TYPES, AgentType};

use crate::batch::Batch;
use crate::net::graph::Encoded;
use crate::net::gru::{self, BurnIn, Unroll};
use crate::net::matrix::{Into, Matrix, by_matrix, forward};
use crate::net::motion::{self, Start};
use crate::net::tensors::{Gradients, Tensors};

/// Outputs of the decoder's head per step.
pub(crate) const RAW: usize = nn::RAW_CONTROL;

/// The encoded agents of one type in a batch that are forecast.
pub(crate) struct TypeForecast<'a> {
    config: &'a ModelConfig,
    batch: &'a Batch<'a>,
    weights: &'a Tensors,
    pub(crate) agent_type: AgentType,
    pub(crate) agents: Range<usize>,
    /// ṽ `[agents, 64]`.
    pub(crate) encoding: Matrix,
    /// The hidden state after the history.
    pub(crate) burn_in: BurnIn,
}

/// Trajectories of every agent of a type and draw: row = agent × draws + draw.
pub(crate) struct Rollout {
    pub(crate) unroll: Unroll,
    /// Mean of the controls with the base, before saturation `[rows, horizon × 2]`.
    pub(crate) mean: Matrix,
    /// Positions in agent frames `[rows, horizon × 2]`.
    pub(crate) positions: Matrix,
}

impl<'a> TypeForecast<'a> {
    /// `None` if the batch has no agent of the type to forecast.
    pub(crate) fn new(
        weights: &'a Tensors,
        config: &'a ModelConfig,
        batch: &'a Batch<'a>,
        encoded: &Encoded,
        of_type: usize,
    ) -> Option<Self> {
        let agents = batch.forecast[of_type].clone();
        if agents.is_empty() {
            return None;
        }
        let agent_type = AGENT_TYPES[of_type];
        let name = decoder(config, agent_type);
        let state = batch.state.rows_of(agents.clone());
        let present = batch.present.rows_of(agents.clone());
        Some(Self {
            config,
            batch,
            weights,
            agent_type,
            encoding: encoded.encoding.rows_of(agents.clone()),
            burn_in: gru::burn_in(weights, &name, &state, &present),
            agents,
        })
    }

    pub(crate) fn weights(&self) -> &'a Tensors {
        self.weights
    }

    /// Prefix of the tensor names of the type's decoder.
    pub(crate) fn name(&self) -> String {
        decoder(self.config, self.agent_type)
    }

    /// Learned points as latent variables, each with the linear function of its base control. `modes` holds
    /// the same number of modes per agent. Mode [`ModelConfig::modes`] is the point of the single best
    /// forecast.
    fn points(&self, modes: &[usize], base: Option<&Matrix>) -> Matrix {
        let name = self.name();
        let points = self.weights.matrix(&format!("{name}.latents"));
        let best = self.config.best_latent.then(|| self.weights.get(&format!("{name}.latent_best")));
        let point = |mode: usize| match best {
            Some(best) if mode == self.config.modes => best,
            _ => points.row(mode),
        };
        let values = modes.iter().flat_map(|&mode| point(mode)).copied().collect();
        let mut latent = Matrix::new(modes.len(), points.cols, values);
        if let (true, Some(base)) = (self.config.base_latent, base) {
            let matrix = self.weights.matrix(&format!("{name}.latent_base.weight"));
            forward(self.scaled(base).view(), matrix, latent.view_mut(), Into::Add);
        }
        latent
    }

    /// A base control in the scale of the latent variables.
    fn scaled(&self, base: &Matrix) -> Matrix {
        let scale = nn::base::latent_scale(self.config, self.agent_type);
        let mut scaled = base.clone();
        for control in scaled.values.as_chunks_mut::<2>().0 {
            *control = [control[0] * scale[0], control[1] * scale[1]];
        }
        scaled
    }

    /// Forecasts by latent variables `[agents × draws, 32]` and a base control.
    pub(crate) fn decode(&self, latent: &Matrix, base: Option<Matrix>, keep_trace: bool) -> Rollout {
        let horizon_len = self.config.horizon_len;
        let name = self.name();
        let hidden = &self.burn_in.hidden;
        let mut unroll =
            gru::unroll(self.weights, (&name, hidden, &self.encoding, latent), horizon_len, keep_trace);
        self.fade(&mut unroll.raw);
        let mut mean = base.unwrap_or_else(|| Matrix::zeros(latent.rows, 2 * horizon_len));
        let (raw, _) = unroll.raw.values.as_chunks::<RAW>();
        for (mean, raw) in mean.values.as_chunks_mut::<2>().0.iter_mut().zip(raw) {
            mean[0] += raw[0];
            mean[1] += raw[1];
        }
        let positions = self.positions(&mean);
        Rollout { unroll, mean, positions }
    }

    /// Scales the means of the network's controls, or gradients by them, `[agents × draws, horizon × 5]`. The
    /// factor is the share that is kept at the agents' distance from the base's support.
    fn fade(&self, raw: &mut Matrix) {
        let draw_count = raw.rows / self.agents.len();
        for row in 0..raw.rows {
            let share = match self.batch.base.get(self.agents.start + row / draw_count) {
                Some(base) if base.share < 1.0 => base.share,
                _ => continue,
            };
            for raw in raw.row_mut(row).as_chunks_mut::<RAW>().0 {
                raw[0] *= share;
                raw[1] *= share;
            }
        }
    }

    /// Forecasts by learned points, each with the base of its mode.
    pub(crate) fn by_points(&self, modes: &[usize], keep_trace: bool) -> Rollout {
        let base = self.config.base.then(|| self.base(modes));
        self.decode(&self.points(modes, base.as_ref()), base, keep_trace)
    }

    /// Base controls. `modes` holds the same number of modes per agent. The single best forecast has no
    /// anchor.
    pub(crate) fn base(&self, modes: &[usize]) -> Matrix {
        let control_count = 2 * self.config.horizon_len;
        let draw_count = modes.len() / self.agents.len();
        let mut values = Vec::with_capacity(modes.len() * control_count);
        for (row, &mode) in modes.iter().enumerate() {
            let base = &self.batch.base[self.agents.start + row / draw_count];
            let anchor = &base.anchors[mode * control_count..][..control_count];
            values.extend(base.ridge.iter().zip(anchor).map(|(ridge, anchor)| ridge + anchor));
        }
        Matrix::new(modes.len(), control_count, values)
    }

    /// Positions under controls before saturation `[agents × draws, horizon × 2]`.
    pub(crate) fn positions(&self, controls: &Matrix) -> Matrix {
        let draw_count = controls.rows / self.agents.len();
        motion::positions(self.config, self.agent_type, self.starts(), draw_count, controls)
    }

    /// Gradient by the controls, given the gradient by their positions.
    pub(crate) fn positions_backward(&self, controls: &Matrix, d_positions: &Matrix) -> Matrix {
        let draw_count = controls.rows / self.agents.len();
        let starts = self.starts();
        motion::positions_backward(self.config, self.agent_type, starts, draw_count, controls, d_positions)
    }

    /// True positions `[agents, horizon × 2]`, and 1 for each known one `[agents, horizon]`.
    pub(crate) fn truth(&self) -> (Matrix, Matrix) {
        let of = |matrix: &Matrix| matrix.rows_of(self.agents.clone());
        (of(&self.batch.truth), of(&self.batch.counts))
    }

    /// The backward pass of a rollout and of the burn-in. Adds to the gradients of the decoder and to
    /// `d_encoding` `[all agents, 64]`. Returns the gradient by the latent variables.
    pub(crate) fn backward(
        &self,
        gradients: &mut Gradients,
        rollout: &Rollout,
        d_raw: &Matrix,
        d_encoding: &mut Matrix,
    ) -> Matrix {
        let mut d_raw = d_raw.clone();
        self.fade(&mut d_raw);
        let back = rollout.unroll.backward(self.weights, gradients, &d_raw);
        self.burn_in.backward(self.weights, gradients, back.hidden);
        for (agent, d_row) in self.agents.clone().zip(back.encoding.values.chunks_exact(back.encoding.cols)) {
            d_encoding.row_mut(agent).iter_mut().zip(d_row).for_each(|(sum, d)| *sum += d);
        }
        back.latent
    }

    /// Adds the gradients of learned points, given the gradients by the latent variables of
    /// [`TypeForecast::points`].
    pub(crate) fn points_backward(&self, gradients: &mut Gradients, modes: &[usize], d_latent: &Matrix) {
        let name = self.name();
        for (row, &mode) in modes.iter().enumerate() {
            let d_row = d_latent.row(row);
            let sum = if mode == self.config.modes {
                gradients.get_mut(&format!("{name}.latent_best"))
            } else {
                &mut gradients.get_mut(&format!("{name}.latents"))[mode * d_row.len()..][..d_row.len()]
            };
            sum.iter_mut().zip(d_row).for_each(|(sum, d)| *sum += d);
        }
        if self.config.base_latent {
            let base = self.scaled(&self.base(modes));
            by_matrix(
                d_latent.view(),
                base.view(),
                gradients.matrix_mut(&format!("{name}.latent_base.weight")),
            );
        }
    }

    fn starts(&self) -> &[Start] {
        &self.batch.starts[self.agents.clone()]
    }
}

fn decoder(config: &ModelConfig, agent_type: AgentType) -> String {
    format!("decoder.{}", config.network_of(agent_type).name())
}
