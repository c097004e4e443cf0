//! The tensors of a model \[model §3\]: names, shapes, and initial values.

use nn::{Attention, Latents, ModelConfig, NodeTypes, Stem, Temporal};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, Uniform};
use wire::{AGENT_TYPES, AgentType};

use super::tensors::{TensorRole, Tensors};

/// The agent types in the names of tensors: vehicle, cyclist, pedestrian.
pub(crate) const TYPE_NAMES: [&str; 3] = ["vehicle", "cyclist", "pedestrian"];

/// Linear layers of the state and relation perceptrons.
pub(crate) const PERCEPTRON_LAYERS: usize = 4;
/// Components of a state or relation feature vector.
pub(crate) const FEATURES: usize = 6;
const HIDDEN: usize = 128;
const NODE: usize = 64;
const EDGE: usize = 16;
const CONTEXT: usize = 32;
pub(crate) const LATENT: usize = 32;
const CONTROL: usize = 5;
/// Initial value of the softplus's argument in λ and μ, at which both are 1.
const SOFTPLUS_OF_ONE: f32 = 0.541_324_9;
/// Scale of the initial last layers that add to a base. Training therefore starts close to the base.
const SMALL: f32 = 0.02;
/// ln of the initial deviations of controls: acceleration (m/s²) and slip rate (rad/s).
const VEHICLE_LN_DEVIATION: [f32; 2] = [-0.7, -2.5];
/// ln of the initial deviations of displacements (m).
const LN_DEVIATION: [f32; 2] = [-2.5, -2.5];

/// Units of a vehicle's accelerations (m/s²) and slip rates (rad/s) in which the head is learned. A constant
/// slip rate of 0.001 rad/s moves the position after 4.8 s at 10 m/s by more than a metre.
const VEHICLE_UNITS: [f32; 2] = [0.2, 0.01];
/// Units of displacements (m) in which the heads of the other types are learned.
const UNITS: [f32; 2] = [0.1, 0.1];

/// Initial values of a tensor.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fill {
    Constant(f32),
    /// Uniform in ± the value.
    Uniform(f32),
    /// Normal with this standard deviation.
    Normal(f32),
    /// The bias of a decoder's head: means zero, these logarithms of the deviations, no correlation.
    Head([f32; 2]),
}

/// One tensor of a model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    /// Name in the safetensors file.
    pub(crate) name: String,
    pub(crate) shape: Vec<usize>,
    /// How training changes it.
    pub(crate) role: TensorRole,
    fill: Fill,
}

/// All tensors of a model with this configuration, including the base control.
#[must_use]
pub(crate) fn layout(config: &ModelConfig) -> Vec<Entry> {
    let mut entries = Entries::default();
    let networks = AGENT_TYPES.into_iter().filter(|agent_type| config.network_of(*agent_type) == *agent_type);
    for network in networks.clone() {
        let name = format!("fe.state.{}", network.name());
        entries.perceptron(&name, FEATURES, config.state_embedding_len());
    }
    entries.perceptron("fe.relation", FEATURES, EDGE);
    if config.context {
        entries.context(config);
    }
    entries.attention(config);
    entries.dense("encoder.0", 2 * NODE, HIDDEN);
    entries.dense("encoder.1", HIDDEN, HIDDEN);
    entries.dense("encoder.2", HIDDEN, LATENT);
    networks.for_each(|network| entries.decoder(config, network));
    if config.base {
        TYPE_NAMES.iter().for_each(|agent_type| entries.base(config, agent_type));
    }
    entries.0
}

/// Initial weights; the same seed gives the same weights.
#[must_use]
pub(crate) fn initial(config: &ModelConfig, seed: u64) -> Tensors {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut tensors = Tensors::default();
    for entry in layout(config) {
        let len = entry.shape.iter().product();
        let values = match entry.fill {
            Fill::Constant(value) => vec![value; len],
            Fill::Uniform(bound) => {
                let uniform =
                    Uniform::new_inclusive(-bound, bound).expect("the bound is positive and finite");
                (0..len).map(|_| uniform.sample(&mut random)).collect()
            }
            Fill::Normal(deviation) => (0..len)
                .map(|_| deviation * Distribution::<f32>::sample(&StandardNormal, &mut random))
                .collect(),
            Fill::Head([first, second]) => vec![0.0, 0.0, first, second, 0.0],
        };
        tensors.insert(&entry.name, &entry.shape, values, entry.role);
    }
    tensors
}

/// Units in which a tensor is learned, as if value / unit were the parameter; `None` if all units are 1.
///
/// The optimiser moves all parameters by steps of about the same size. In a head's last layer such a step
/// would shift every forecast by metres.
pub(crate) fn units(config: &ModelConfig, name: &str, shape: &[usize]) -> Option<Vec<f32>> {
    let of_decoder = name.strip_prefix("decoder.")?;
    let (network, _) = of_decoder.split_once(".head.")?;
    let of_vehicles = config.network_of(AgentType::Vehicle).name() == network;
    let [first, second] = match (of_vehicles && config.drives(AgentType::Vehicle), config.node_types) {
        (false, _) => UNITS,
        (true, NodeTypes::Own) => VEHICLE_UNITS,
        // One network for all types uses the smallest units.
        (true, NodeTypes::Same) => [0, 1].map(|control| UNITS[control].min(VEHICLE_UNITS[control])),
    };
    let row_len: usize = shape[1..].iter().product();
    Some(
        [first, second, 1.0, 1.0, 1.0]
            .into_iter()
            .flat_map(|unit| std::iter::repeat_n(unit, row_len))
            .collect(),
    )
}

#[derive(Default)]
struct Entries(Vec<Entry>);

impl Entries {
    fn push(&mut self, name: String, shape: &[usize], role: TensorRole, fill: Fill) {
        self.0.push(Entry { name, shape: shape.to_vec(), role, fill });
    }

    fn learned(&mut self, name: String, shape: &[usize], fill: Fill) {
        self.push(name, shape, TensorRole::Learned, fill);
    }

    /// Changes the initial values of a tensor that is already listed.
    fn learned_as(&mut self, name: &str, fill: Fill) {
        self.0.iter_mut().filter(|entry| entry.name == name).for_each(|entry| entry.fill = fill);
    }

    /// A linear layer whose initial values are `scale` times PyTorch's.
    fn scaled_dense(&mut self, name: &str, inputs: usize, outputs: usize, scale: f32) {
        let bound = Fill::Uniform(scale / (inputs as f32).sqrt());
        self.learned(format!("{name}.weight"), &[outputs, inputs], bound);
        self.learned(format!("{name}.bias"), &[outputs], bound);
    }

    fn dense(&mut self, name: &str, inputs: usize, outputs: usize) {
        self.scaled_dense(name, inputs, outputs, 1.0);
    }

    fn perceptron(&mut self, name: &str, inputs: usize, outputs: usize) {
        for layer in 0..PERCEPTRON_LAYERS {
            let from = if layer == 0 { inputs } else { HIDDEN };
            let to = if layer + 1 == PERCEPTRON_LAYERS { outputs } else { HIDDEN };
            self.dense(&format!("{name}.{layer}"), from, to);
        }
    }

    fn context(&mut self, config: &ModelConfig) {
        let width = config.width;
        let kernel = if config.stem == Stem::Imagenet { 7 } else { 3 };
        self.convolution("conv1", "bn1", 3, width, kernel);
        let mut from = width;
        for stage in 1..=4_usize {
            let to = width << (stage - 1);
            for block in 0..2 {
                let name = format!("layer{stage}.{block}");
                self.convolution(&format!("{name}.conv1"), &format!("{name}.bn1"), from, to, 3);
                self.convolution(&format!("{name}.conv2"), &format!("{name}.bn2"), to, to, 3);
                if stage > 1 && block == 0 {
                    let name = format!("{name}.downsample");
                    self.convolution(&format!("{name}.0"), &format!("{name}.1"), from, to, 1);
                }
                from = to;
            }
        }
        let scale = if config.base { 0.1 } else { 1.0 };
        self.scaled_dense("fe.context.fc", from, CONTEXT, scale);
    }

    fn convolution(&mut self, convolution: &str, norm: &str, from: usize, to: usize, kernel: usize) {
        let deviation = (2.0 / (to * kernel * kernel) as f32).sqrt();
        let shape = [to, from, kernel, kernel];
        self.learned(format!("fe.context.{convolution}.weight"), &shape, Fill::Normal(deviation));
        let name = format!("fe.context.{norm}");
        self.learned(format!("{name}.weight"), &[to], Fill::Constant(1.0));
        self.learned(format!("{name}.bias"), &[to], Fill::Constant(0.0));
        self.push(format!("{name}.running_mean"), &[to], TensorRole::Statistic, Fill::Constant(0.0));
        self.push(format!("{name}.running_var"), &[to], TensorRole::Statistic, Fill::Constant(1.0));
    }

    fn attention(&mut self, config: &ModelConfig) {
        let bound = |inputs: usize| Fill::Uniform(1.0 / (inputs as f32).sqrt());
        for round in 0..config.rounds {
            let name = format!("gdat.topological.{round}");
            let heads = [config.topological_heads];
            self.learned(format!("{name}.w_n.weight"), &[NODE, NODE], bound(NODE));
            if config.attention == Attention::Dual {
                self.learned(format!("{name}.lambda_raw"), &heads, Fill::Constant(SOFTPLUS_OF_ONE));
                self.learned(format!("{name}.mu_raw"), &heads, Fill::Constant(SOFTPLUS_OF_ONE));
            }
            if config.edge_in_message {
                self.learned(format!("{name}.u_e.weight"), &[NODE, EDGE], bound(EDGE));
            }
            if round + 1 < config.rounds {
                self.dense(&format!("{name}.edge.0"), 2 * NODE + EDGE, HIDDEN);
                self.dense(&format!("{name}.edge.1"), HIDDEN, EDGE);
            }
        }
        let literal = config.temporal == Temporal::Literal;
        let heads = if literal { NODE } else { config.temporal_heads };
        if literal || config.attention == Attention::Dual {
            self.learned("gdat.temporal.score.weight".to_owned(), &[heads, NODE], bound(NODE));
        }
        if !literal {
            self.learned("gdat.temporal.value.weight".to_owned(), &[NODE, NODE], bound(NODE));
        }
    }

    fn decoder(&mut self, config: &ModelConfig, network: AgentType) {
        let name = format!("decoder.{}", network.name());
        let bound = Fill::Uniform(1.0 / (HIDDEN as f32).sqrt());
        self.learned(format!("{name}.gru.weight_ih"), &[3 * HIDDEN, FEATURES + NODE + LATENT], bound);
        self.learned(format!("{name}.gru.weight_hh"), &[3 * HIDDEN, HIDDEN], bound);
        self.learned(format!("{name}.gru.bias_ih"), &[3 * HIDDEN], bound);
        self.learned(format!("{name}.gru.bias_hh"), &[3 * HIDDEN], bound);
        let scale = if config.base { SMALL } else { 1.0 };
        self.scaled_dense(&format!("{name}.head"), HIDDEN, CONTROL, scale);
        if config.base {
            let spread = if config.drives(network) { VEHICLE_LN_DEVIATION } else { LN_DEVIATION };
            self.learned_as(&format!("{name}.head.bias"), Fill::Head(spread));
        }
        if config.latents == Latents::Points {
            self.learned(format!("{name}.latents"), &[config.modes, LATENT], Fill::Normal(1.0));
        }
        if config.base_latent {
            let controls = 2 * config.horizon_len;
            let bound = Fill::Uniform(1.0 / (controls as f32).sqrt());
            self.learned(format!("{name}.latent_base.weight"), &[LATENT, controls], bound);
        }
        if config.best_latent {
            self.learned(format!("{name}.latent_best"), &[LATENT], Fill::Normal(1.0));
        }
        if config.mode_head {
            self.dense(&format!("{name}.mode.0"), NODE + HIDDEN, NODE);
            self.dense(&format!("{name}.mode.1"), NODE, config.modes);
        }
    }

    fn base(&mut self, config: &ModelConfig, agent_type: &str) {
        let mut fixed = |tensor: &str, shape: &[usize]| {
            self.push(format!("base.{agent_type}.{tensor}"), shape, TensorRole::Fixed, Fill::Constant(0.0));
        };
        let controls = 2 * config.horizon_len;
        fixed("ridge", &[nn::base::CLASSES, nn::base::SPEED_BINS, nn::base::FEATURES, controls]);
        fixed("anchors", &[nn::base::BINS, config.modes, config.horizon_len, 2]);
        fixed("speed_cuts", &[nn::base::SPEED_BINS - 1]);
        if config.base_support {
            fixed("support", &[nn::base::CLASSES, nn::base::FEATURES, 2]);
        }
    }
}
