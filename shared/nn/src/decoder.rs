//! The decoder: a gated recurrent unit per agent type, from history and latent variable to control Gaussians.
//!
//! Parts that do not depend on the draw are computed once: the burn-in and ṽ·W per agent, z·W per latent
//! point. A point depends linearly on its base control, so W applies directly to the control. From the second
//! forecast step the input is zero, so only its bias remains.
//!
//! In bf16 only the recurrent product W_h h is computed with reduced precision: 24 of 25 multiply-adds of a
//! step. The state h itself, its gates and all other layers stay in f32, so that rounding errors do not
//! accumulate over the steps.

mod group;

use wire::{AGENT_TYPES, AgentType, ControlGaussian, LATENT, STATE_FEATURES, TEMPORAL};

use crate::base::{Base, latent_scale};
use crate::buffer::Buffer;
use crate::kernels::bf16::DotProducts;
use crate::kernels::exp_in_place;
use crate::kernels::gates::{GATES, HIDDEN, gru_step};
use crate::linear::{Activation, Linear};
use crate::weights::{Weights, WeightsError};
use crate::{Latents, Precision, StartError};
pub use group::{AgentDraws, DecoderGroup, Encoded};

/// Outputs of the head: (μ_1, μ_2, ln l_11, ln l_22, l_21).
pub const RAW_CONTROL: usize = 5;
/// Bounds of ln l.
const LOG_SCALE: [f32; 2] = [-5.0, 2.0];
/// Rows that are decoded together.
const BLOCK: usize = 48;
/// Hidden units of the mode head.
const MODE_HIDDEN: usize = 64;

/// The control Gaussian of a row of the decoder's head.
#[must_use]
pub fn control_gaussian([mean_1, mean_2, log_11, log_22, l_21]: [f32; RAW_CONTROL]) -> ControlGaussian {
    let scale = |log: f32| log.clamp(LOG_SCALE[0], LOG_SCALE[1]).exp();
    ControlGaussian { mean: [mean_1, mean_2], cholesky: [scale(log_11), l_21, scale(log_22)] }
}

/// The decoders of all agent types.
pub struct Decoder {
    types: [TypeDecoder; 3],
}

/// The decoder of one agent type.
pub struct TypeDecoder {
    state: Linear,
    context: Linear,
    latent: Linear,
    hidden: Linear,
    /// W_h h + b_h of the initial state 0, before all history.
    at_rest: Buffer,
    /// b_ih: the gates' input after the first forecast step.
    idle: Buffer,
    head: Linear,
    points: Option<Points>,
    /// Maps base controls to their term in the gates.
    latent_base: Option<Linear>,
    best_latent: Option<[f32; LATENT]>,
    modes: Option<ModeHead>,
    base: Option<Base>,
}

/// The gates' terms z·W of the learned latent points; the best forecast's point is the last.
struct Points {
    gates: Buffer,
    len: usize,
}

struct ModeHead {
    first: Linear,
    second: Linear,
    modes_len: usize,
}

/// The history of agents of one type, the input of the burn-in.
#[derive(Clone, Copy, Debug)]
pub struct BurnIn<'a> {
    /// Number of agents.
    pub agents_len: usize,
    /// State features s, \[step, agent\].
    pub states: &'a [[f32; STATE_FEATURES]],
    /// Whether an agent has a state at a step, \[step, agent\].
    pub present: &'a [bool],
}

/// The source of a forecast's latent variables.
#[derive(Clone, Copy, Debug)]
pub enum Draws<'a> {
    /// The learned points of the type. If the model has `base_latent`, the base controls move the points.
    /// They are \[agent, mode, step\], with those of the best forecast after the modes. Other models do not
    /// read them.
    Points(&'a [[f32; 2]]),
    /// Given latent variables, \[agent, draw\].
    Given(&'a [[f32; LATENT]]),
}

/// Scratch memory of [`TypeDecoder`].
#[derive(Default)]
pub struct DecoderMemory {
    /// W_i x + b_i and W_h h + b_h, \[row, gate\].
    input: Buffer,
    gates: Buffer,
    /// h, \[row, 128\].
    state: Buffer,
    /// The head's output, \[row, 16\].
    raw: Buffer,
    /// ṽ·W, \[agent, gate\], and z·W of given draws, \[agent, draw, gate\].
    context: Buffer,
    latent: Buffer,
    /// W_h h + b_h of the first step, \[agent, gate\].
    first: Buffer,
    /// Base controls, \[row, step, component\].
    base: Buffer,
    /// \[ṽ ‖ h\] and the two layers of the mode head.
    joined: Buffer,
    mode_hidden: Buffer,
    mode_scores: Buffer,
}

impl Decoder {
    /// The layers `decoder.*` and, if the configuration has them, latent points, mode head and base control.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        Self::read(weights, None)
    }

    /// As [`Decoder::new`], with the given precision of the recurrent layer.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not contain the model, or this process can't compute in the
    /// precision.
    pub fn with_precision(weights: &Weights, precision: Precision) -> Result<Self, StartError> {
        Ok(Self::read(weights, precision.dot_products()?)?)
    }

    fn read(weights: &Weights, dot_products: Option<DotProducts>) -> Result<Self, WeightsError> {
        let [vehicle, cyclist, pedestrian] = AGENT_TYPES;
        let read = |agent_type| TypeDecoder::read(weights, agent_type, dot_products);
        Ok(Self { types: [read(vehicle)?, read(cyclist)?, read(pedestrian)?] })
    }

    /// The decoder of a type.
    #[must_use]
    pub const fn of(&self, agent_type: AgentType) -> &TypeDecoder {
        &self.types[agent_type.index()]
    }
}

impl TypeDecoder {
    fn read(
        weights: &Weights,
        agent_type: AgentType,
        dot_products: Option<DotProducts>,
    ) -> Result<Self, WeightsError> {
        let config = weights.config();
        let network = config.network_of(agent_type).name();
        let name = |part: &str| format!("decoder.{network}.{part}");
        let shape = [GATES, STATE_FEATURES + TEMPORAL + LATENT];
        let input = weights.tensor(&name("gru.weight_ih"), &shape)?;
        let input_bias = weights.tensor(&name("gru.bias_ih"), &[GATES])?;
        let recurrent = weights.tensor(&name("gru.weight_hh"), &[GATES, HIDDEN])?;
        let recurrent_bias = weights.tensor(&name("gru.bias_hh"), &[GATES])?;
        let section = |start, len, bias| Linear::pack(input, bias, shape, start..start + len);
        let latent = section(STATE_FEATURES + TEMPORAL, LATENT, None);
        let mut best_latent = None;
        if config.best_latent {
            best_latent = weights.tensor(&name("latent_best"), &[LATENT])?.first_chunk().copied();
        }
        let mut points = None;
        if config.latents == Latents::Points {
            let learned = weights.tensor(&name("latents"), &[config.modes, LATENT])?;
            points = Some(Points::new(learned, best_latent.as_ref(), &latent));
        }
        let mut latent_base = None;
        if config.base_latent {
            let control_count = 2 * config.horizon_len;
            let matrix = weights.tensor(&name("latent_base.weight"), &[LATENT, control_count])?;
            let of_latent = input.chunks_exact(shape[1]).map(|row| &row[STATE_FEATURES + TEMPORAL..]);
            let folded = fold(of_latent, matrix, latent_scale(config, agent_type), control_count);
            latent_base = Some(Linear::pack(&folded, None, [GATES, control_count], 0..control_count));
        }
        let mut idle = Buffer::zeroed(GATES);
        idle.copy_from_slice(input_bias);
        let hidden = Linear::pack_as(dot_products, recurrent, recurrent_bias, [GATES, HIDDEN]);
        let mut at_rest = Buffer::zeroed(GATES);
        hidden.run(&[0.0; HIDDEN], HIDDEN, Activation::None, &mut at_rest);
        Ok(Self {
            state: section(0, STATE_FEATURES, Some(input_bias)),
            context: section(STATE_FEATURES, TEMPORAL, Some(input_bias)),
            latent,
            hidden,
            at_rest,
            idle,
            head: Linear::read(weights, &name("head"), RAW_CONTROL, HIDDEN)?,
            points,
            latent_base,
            best_latent,
            modes: config.mode_head.then(|| ModeHead::read(weights, &name("mode"))).transpose()?,
            base: config.base.then(|| Base::read(weights, agent_type)).transpose()?,
        })
    }

    /// The base control, if the model has one.
    pub const fn base(&self) -> Option<&Base> {
        self.base.as_ref()
    }

    /// Hidden states h after the present history steps, one row per agent.
    ///
    /// # Panics
    /// If the sizes of states, presence and `hidden` do not match.
    pub fn burn_in(&self, agents: &BurnIn<'_>, memory: &mut DecoderMemory, hidden: &mut [[f32; HIDDEN]]) {
        let row_count = agents.agents_len;
        assert_eq!(agents.states.len(), agents.present.len(), "presence of each state");
        assert_eq!(hidden.len(), row_count, "a row per agent");
        hidden.as_flattened_mut().fill(0.0);
        if row_count == 0 {
            return;
        }
        memory.reserve(row_count);
        let steps = agents.states.chunks_exact(row_count).zip(agents.present.chunks_exact(row_count));
        for (step, (states, present)) in steps.enumerate() {
            let input = &mut memory.input[..row_count * GATES];
            let gates = &mut memory.gates[..row_count * GATES];
            let next = &mut memory.state[..row_count * HIDDEN];
            self.state.run(states.as_flattened(), STATE_FEATURES, Activation::None, input);
            if step == 0 {
                gates.chunks_exact_mut(GATES).for_each(|row| row.copy_from_slice(&self.at_rest));
            } else {
                self.hidden.run(hidden.as_flattened(), HIDDEN, Activation::None, gates);
            }
            next.copy_from_slice(hidden.as_flattened());
            gru_step(input, gates, next);
            for ((row, next), _) in
                hidden.iter_mut().zip(next.as_chunks().0).zip(present).filter(|(_, present)| **present)
            {
                *row = *next;
            }
        }
    }

    /// The head's outputs, \[agent, draw, step\], for agents with the given hidden states and temporal
    /// summaries.
    ///
    /// With [`Draws::Points`] the draws are the learned points, followed by the point of the best forecast if
    /// the model has one.
    ///
    /// # Panics
    /// If the sizes do not match, or if points are requested and the model has none.
    pub fn forecast(
        &self,
        hidden: &[[f32; HIDDEN]],
        temporal: &[[f32; TEMPORAL]],
        draws: Draws<'_>,
        memory: &mut DecoderMemory,
        out: &mut [[f32; RAW_CONTROL]],
    ) {
        let agents_len = hidden.len();
        assert_eq!(temporal.len(), agents_len, "a summary per agent");
        if agents_len == 0 {
            return;
        }
        memory.reserve(BLOCK);
        memory.context.reserve(agents_len * GATES);
        memory.first.reserve(agents_len * GATES);
        let context = &mut memory.context[..agents_len * GATES];
        self.context.run(temporal.as_flattened(), TEMPORAL, Activation::None, context);
        // All draws of an agent start from its state, so they share the first step's recurrent half.
        let first_gates = &mut memory.first[..agents_len * GATES];
        self.hidden.run(hidden.as_flattened(), HIDDEN, Activation::None, first_gates);
        let (draw_count, shared) = match draws {
            Draws::Points(_) => (self.point_count(), true),
            Draws::Given(latents) => {
                memory.latent.reserve(latents.len() * GATES);
                let gates = &mut memory.latent[..latents.len() * GATES];
                self.latent.run(latents.as_flattened(), LATENT, Activation::None, gates);
                (latents.len() / agents_len, false)
            }
        };
        let row_count = agents_len * draw_count;
        assert!(row_count > 0 && out.len().is_multiple_of(row_count), "whole steps");
        let horizon_len = out.len() / row_count;
        for first in (0..row_count).step_by(BLOCK) {
            let len = BLOCK.min(row_count - first);
            for block_row in 0..len {
                let (agent, draw) = ((first + block_row) / draw_count, (first + block_row) % draw_count);
                memory.state[block_row * HIDDEN..][..HIDDEN].copy_from_slice(&hidden[agent]);
                let latent = match &self.points {
                    Some(points) if shared => &points.gates[draw * GATES..][..GATES],
                    _ => &memory.latent[(first + block_row) * GATES..][..GATES],
                };
                let context = &memory.context[agent * GATES..][..GATES];
                let input = &mut memory.input[block_row * GATES..][..GATES];
                let sums = context.iter().zip(latent).map(|(c, z)| c + z);
                input.iter_mut().zip(sums).for_each(|(input, sum)| *input = sum);
            }
            if let (Some(layer), Draws::Points(base)) = (&self.latent_base, draws) {
                let rows = (first..first + len).map(|row| (row / draw_count, row % draw_count));
                add_base(layer, base, agents_len, horizon_len, rows, memory);
            }
            for (block_row, gates) in memory.gates[..len * GATES].chunks_exact_mut(GATES).enumerate() {
                let agent = (first + block_row) / draw_count;
                gates.copy_from_slice(&memory.first[agent * GATES..][..GATES]);
            }
            self.unroll(len, horizon_len, memory, &mut out[first * horizon_len..][..len * horizon_len]);
        }
    }

    /// Unrolls the rows in `memory` (state, first input and first recurrent half) over the horizon.
    fn unroll(
        &self,
        len: usize,
        horizon_len: usize,
        memory: &mut DecoderMemory,
        out: &mut [[f32; RAW_CONTROL]],
    ) {
        let DecoderMemory { input, gates, state, raw, .. } = memory;
        let (gates, state) = (&mut gates[..len * GATES], &mut state[..len * HIDDEN]);
        let stride = self.head.out_stride();
        for step in 0..horizon_len {
            let input = if step == 0 {
                &input[..len * GATES]
            } else {
                self.hidden.run(state, HIDDEN, Activation::None, gates);
                &self.idle[..]
            };
            gru_step(input, gates, state);
            self.head.run(state, HIDDEN, Activation::None, &mut raw[..len * stride]);
            for (row, raw) in raw[..len * stride].chunks_exact(stride).enumerate() {
                out[row * horizon_len + step].copy_from_slice(&raw[..RAW_CONTROL]);
            }
        }
    }

    /// Number of learned latent points, including the best forecast's; 0 if the model draws from N(0, I).
    pub fn point_count(&self) -> usize {
        self.points.as_ref().map_or(0, |points| points.len)
    }

    /// The latent point of the best forecast, if the model has one.
    pub const fn best_latent(&self) -> Option<&[f32; LATENT]> {
        self.best_latent.as_ref()
    }

    /// Probabilities of the modes, \[agent, mode\]. Returns `false` and leaves `out` unchanged if the model
    /// has no mode head.
    ///
    /// # Panics
    /// If the sizes do not match.
    pub fn mode_probabilities(
        &self,
        hidden: &[[f32; HIDDEN]],
        temporal: &[[f32; TEMPORAL]],
        memory: &mut DecoderMemory,
        out: &mut [f32],
    ) -> bool {
        let Some(head) = &self.modes else { return false };
        assert_eq!(temporal.len(), hidden.len(), "a summary per agent");
        assert_eq!(out.len(), hidden.len() * head.modes_len, "a probability per agent and mode");
        let (len, width) = (hidden.len(), TEMPORAL + HIDDEN);
        let stride = head.second.out_stride();
        let DecoderMemory { joined, mode_hidden, mode_scores, .. } = memory;
        joined.reserve(len * width);
        mode_hidden.reserve(len * MODE_HIDDEN);
        mode_scores.reserve(len * stride);
        for (joined, (temporal, hidden)) in joined.chunks_exact_mut(width).zip(temporal.iter().zip(hidden)) {
            joined[..TEMPORAL].copy_from_slice(temporal);
            joined[TEMPORAL..].copy_from_slice(hidden);
        }
        let mode_hidden = &mut mode_hidden[..len * MODE_HIDDEN];
        head.first.run(joined, width, Activation::Relu, mode_hidden);
        let scores = &mut mode_scores[..len * stride];
        head.second.run(mode_hidden, MODE_HIDDEN, Activation::None, scores);
        for (scores, out) in scores.chunks_exact(stride).zip(out.chunks_exact_mut(head.modes_len)) {
            let most = scores[..head.modes_len].iter().fold(f32::NEG_INFINITY, |most, &x| most.max(x));
            out.iter_mut().zip(scores).for_each(|(p, score)| *p = score - most);
            exp_in_place(out);
            let share = 1.0 / out.iter().sum::<f32>();
            out.iter_mut().for_each(|p| *p *= share);
        }
        true
    }
}

/// W·M·diag(scale): maps the controls that M reads, with alternating components, to the gates, \[gate,
/// control\].
fn fold<'w>(
    rows: impl Iterator<Item = &'w [f32]>,
    matrix: &[f32],
    scale: [f32; 2],
    control_count: usize,
) -> Vec<f32> {
    let mut folded = Vec::with_capacity(GATES * control_count);
    for row in rows {
        let entry = |control: usize| {
            let column = matrix.iter().skip(control).step_by(control_count);
            row.iter().zip(column).map(|(w, m)| w * m).sum::<f32>() * scale[control % 2]
        };
        folded.extend((0..control_count).map(entry));
    }
    folded
}

/// Adds the base controls' term to the gates' input at the first forecast step, for `rows` of (agent, mode).
fn add_base(
    layer: &Linear,
    base: &[[f32; 2]],
    agents_len: usize,
    horizon_len: usize,
    rows: impl ExactSizeIterator<Item = (usize, usize)>,
    memory: &mut DecoderMemory,
) {
    let (len, control_count) = (rows.len(), 2 * horizon_len);
    let stride = base.len() / agents_len;
    let DecoderMemory { input, gates, base: gathered, .. } = memory;
    gathered.reserve(BLOCK * control_count);
    for ((agent, mode), out) in rows.zip(gathered.chunks_exact_mut(control_count)) {
        let controls = &base[agent * stride + mode * horizon_len..][..horizon_len];
        out.copy_from_slice(controls.as_flattened());
    }
    let (input, sums) = (&mut input[..len * GATES], &mut gates[..len * GATES]);
    sums.copy_from_slice(input);
    layer.run_onto(&gathered[..len * control_count], control_count, sums, Activation::None, input);
}

impl Points {
    fn new(learned: &[f32], best: Option<&[f32; LATENT]>, latent: &Linear) -> Self {
        let rows: Vec<f32> = learned.iter().chain(best.into_iter().flatten()).copied().collect();
        let len = rows.len() / LATENT;
        let mut gates = Buffer::zeroed(len * GATES);
        latent.run(&rows, LATENT, Activation::None, &mut gates);
        Self { gates, len }
    }
}

impl ModeHead {
    fn read(weights: &Weights, name: &str) -> Result<Self, WeightsError> {
        let modes_len = weights.config().modes;
        Ok(Self {
            first: Linear::read(weights, &format!("{name}.0"), MODE_HIDDEN, TEMPORAL + HIDDEN)?,
            second: Linear::read(weights, &format!("{name}.1"), modes_len, MODE_HIDDEN)?,
            modes_len,
        })
    }
}

impl DecoderMemory {
    fn reserve(&mut self, row_count: usize) {
        self.input.reserve(row_count * GATES);
        self.gates.reserve(row_count * GATES);
        self.state.reserve(row_count * HIDDEN);
        self.raw.reserve(row_count * RAW_CONTROL.next_multiple_of(16));
    }
}
