//! The differentiable network against the golden vectors of an independent float64 implementation.

use std::path::PathBuf;

use burn::tensor::{Device, Tensor};
use nn::ModelConfig;
use safetensors::SafeTensors;
use serde_json::Value;

use super::*;
use crate::batch::{booleans, floats, integers};
use crate::parameters::{Parameters, host};
use crate::{loss, motion};

const FOLDERS: [&str; 4] = ["vehicle", "pedestrian", "plus", "literal"];
const TOLERANCE: f32 = 1e-4;

struct Golden {
    name: &'static str,
    config: ModelConfig,
    weights: Weights,
    tensors: Vec<u8>,
    scene: Value,
    device: Device,
    /// Agents sorted by type.
    order: Vec<usize>,
    types: Vec<usize>,
}

impl Golden {
    fn open(name: &'static str) -> Self {
        let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden")).join(name);
        let read = |file: &str| std::fs::read(folder.join(file)).unwrap();
        let bytes = read("weights.safetensors");
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let config: ModelConfig =
            serde_json::from_str(&header.metadata().as_ref().unwrap()["config"]).unwrap();
        let device = Device::flex();
        let parameters = Parameters::from_safetensors(&bytes, &layout(&config), &device).unwrap();
        let scene: Value = serde_json::from_slice(&read("scene.json")).unwrap();
        let types: Vec<usize> = scene["types"]
            .as_array()
            .unwrap()
            .iter()
            .map(|name| TYPE_NAMES.iter().position(|known| name == known).unwrap())
            .collect();
        let mut order: Vec<usize> = (0..types.len()).collect();
        order.sort_by_key(|&agent| types[agent]);
        let tensors = read("tensors.safetensors");
        Self { name, config, weights: parameters.frozen(), tensors, scene, device, order, types }
    }

    fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        let file = SafeTensors::deserialize(&self.tensors).unwrap();
        let view = file.tensor(name).unwrap();
        let values = view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        (view.shape().to_vec(), values)
    }

    /// Values of `name` at the leading indices, each of a slice of the remaining dimensions.
    fn rows(&self, name: &str, indices: impl Iterator<Item = Vec<usize>>) -> Vec<f32> {
        let (shape, values) = self.tensor(name);
        let mut rows = Vec::new();
        for index in indices {
            let width: usize = shape[index.len()..].iter().product();
            let row = index.iter().zip(&shape).fold(0, |row, (i, len)| row * len + i);
            rows.extend_from_slice(&values[row * width..][..width]);
        }
        rows
    }

    fn check(&self, name: &str, found: &[f32], expected: &[f32]) {
        assert_eq!(found.len(), expected.len(), "{} {name}: length", self.name);
        let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        let worst = found.iter().zip(expected).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(worst <= TOLERANCE * largest, "{} {name}: off by {worst} of {largest}", self.name);
    }

    fn present(&self, step: usize, agent: usize) -> bool {
        self.scene["present"][step][agent].as_bool().unwrap()
    }

    /// The graph of `history` or `future`, and (step, agent) of its rows, (step, receiver, sender) of its edges.
    fn graph(&self, part: &str) -> (Graph, Vec<Vec<usize>>, Vec<Vec<usize>>) {
        let (shape, adjacency) = self.tensor(&format!("{part}.adjacency"));
        let (steps_len, agents_len) = (shape[0], shape[1]);
        let first = if part == "history" { 0 } else { self.config.history_len };
        let mut rows: Vec<Vec<usize>> = Vec::new();
        let mut of_step = Vec::new();
        for &agent in &self.order {
            for step in 0..steps_len {
                let present = self.present(first + step, agent);
                of_step.push(present.then_some(rows.len()));
                if present {
                    rows.push(vec![step, agent]);
                }
            }
        }
        let row_of = |step: usize, agent: usize| rows.iter().position(|row| row == &[step, agent]).unwrap();
        let (mut edges, mut slots) = (Vec::new(), Vec::new());
        for row in &rows {
            for sender in 0..agents_len {
                let joined = adjacency[(row[0] * agents_len + row[1]) * agents_len + sender] > 0.0;
                slots.push(joined.then_some(edges.len()));
                if joined {
                    edges.push(vec![row[0], row[1], sender]);
                }
            }
        }
        let device = &self.device;
        let or_end =
            |list: &[Option<usize>], end: usize| list.iter().map(|i| i.unwrap_or(end)).collect::<Vec<_>>();
        let ends =
            |at: usize| integers(&edges.iter().map(|e| row_of(e[0], e[at])).collect::<Vec<_>>(), device);
        let empty = slots.iter().map(Option::is_none).collect();
        let side = self.config.patch_size;
        let patches = if part == "history" {
            self.rows("history.patches", rows.iter().cloned())
        } else {
            vec![0.0; rows.len() * 3 * side * side]
        };
        let of_type = |agent_type: usize| {
            let inside = |row: &&Vec<usize>| self.types[row[1]] < agent_type;
            rows.iter().filter(inside).count()
        };
        let graph = Graph {
            state: floats(self.rows(&format!("{part}.state"), rows.iter().cloned()), [rows.len(), 6], device),
            type_rows: [0, 1, 2].map(|agent_type| of_type(agent_type)..of_type(agent_type + 1)),
            relation: floats(
                self.rows(&format!("{part}.relation"), edges.iter().cloned()),
                [edges.len(), 6],
                device,
            ),
            edges: Edges {
                receiver: ends(1),
                sender: ends(2),
                slots: integers(&or_end(&slots, edges.len()), device),
                empty: booleans(empty, [rows.len(), agents_len], device),
            },
            steps: integers(&or_end(&of_step, rows.len()), device),
            absent: booleans(of_step.iter().map(Option::is_none).collect(), [agents_len, steps_len], device),
            context: Context {
                patches: floats(patches, [rows.len(), 3, side, side], device),
                of_row: integers(&(0..rows.len()).collect::<Vec<_>>(), device),
                normalisation: Normalisation::Running,
            },
        };
        (graph, rows, edges)
    }

    /// Rows of `[draw, agent, …]` in the order of a rollout: by agent, then draw.
    fn by_agent(&self, name: &str, agents: &[usize]) -> Vec<f32> {
        let draws = self.tensor(name).0[0];
        self.rows(name, agents.iter().flat_map(|&agent| (0..draws).map(move |draw| vec![draw, agent])))
    }
}

fn check_encoded(golden: &Golden, encoded: &Encoded, part: &str, rows: &[Vec<usize>], edges: &[Vec<usize>]) {
    let by_row = |name: &str| golden.rows(&format!("{part}.{name}"), rows.iter().cloned());
    let by_edge = |name: &str| golden.rows(&format!("{part}.{name}"), edges.iter().cloned());
    golden.check("node", &host(encoded.node.clone()), &by_row("node"));
    golden.check("edge", &host(encoded.edge.clone()), &by_edge("edge"));
    for (number, round) in encoded.rounds.iter().enumerate() {
        let name = |tensor: &str| format!("topo{number}.{tensor}");
        golden.check(&name("node"), &host(round.node.clone()), &by_row(&name("node")));
        if let Some(edge) = &round.edge {
            golden.check(&name("edge"), &host(edge.clone()), &by_edge(&name("edge")));
        }
        // Ours is [row, sender, head], theirs [step, head, receiver, sender].
        let [_, senders, heads] = round.alpha.dims();
        let theirs = rows.iter().flat_map(|row| {
            (0..senders)
                .flat_map(move |sender| (0..heads).map(move |head| vec![row[0], head, row[1], sender]))
        });
        let theirs = golden.rows(&format!("{part}.{}", name("alpha")), theirs);
        golden.check(&name("alpha"), &host(round.alpha.clone()), &theirs);
    }
    let [agents, steps, _] = encoded.summary.beta.dims();
    let steps = (0..agents).flat_map(|i| (0..steps).map(move |step| (step, i)));
    let theirs = golden.rows(&format!("{part}.beta"), steps.map(|(step, i)| vec![step, golden.order[i]]));
    golden.check("beta", &host(encoded.summary.beta.clone()), &theirs);
    let theirs = golden.rows(&format!("{part}.temporal"), golden.order.iter().map(|&agent| vec![agent]));
    golden.check("temporal", &host(encoded.summary.encoding.clone()), &theirs);
}

#[test]
fn history_graph_and_decoder_agree_with_the_reference() {
    for name in FOLDERS {
        let golden = Golden::open(name);
        let (graph, rows, edges) = golden.graph("history");
        let encoded = encode(&golden.weights, &golden.config, &graph, &mut Statistics::new());
        check_encoded(&golden, &encoded, "history", &rows, &edges);
        check_decoder(&golden, &encoded);
    }
}

/// `decoder.raw` of every type.
fn check_decoder(golden: &Golden, encoded: &Encoded) {
    for (agent_type, type_name) in TYPE_NAMES.iter().enumerate() {
        let agents: Vec<usize> =
            golden.order.iter().copied().filter(|&a| golden.types[a] == agent_type).collect();
        let Some(first) = golden.order.iter().position(|a| agents.first() == Some(a)) else { continue };
        let steps = golden.config.history_len;
        let by_step = || agents.iter().flat_map(|&agent| (0..steps).map(move |step| vec![step, agent]));
        let state = floats(golden.rows("history.state", by_step()), [agents.len(), steps, 6], &golden.device);
        let present = by_step().map(|at| f32::from(u8::from(golden.present(at[0], at[1])))).collect();
        let present = floats(present, [agents.len(), steps], &golden.device);
        let decoder = Decoder::new(&golden.weights, type_name);
        let hidden = decoder.burn_in(&state, &present);
        let encoding = encoded.summary.encoding.clone().narrow(0, first, agents.len());
        let draws = golden.tensor("latent.z").0[0];
        let latent =
            floats(golden.by_agent("latent.z", &agents), [agents.len(), draws, LATENT], &golden.device);
        let controls = decoder.forward(&hidden, encoding, latent, golden.config.horizon_len);
        golden.check("decoder.raw", &host(controls.raw.clone()), &golden.by_agent("decoder.raw", &agents));
        golden.check("control.mean", &host(controls.mean()), &golden.by_agent("control.mean", &agents));
        let diagonal = host(controls.ln_diagonal().exp());
        let below = host(controls.off_diagonal());
        let cholesky: Vec<f32> =
            diagonal.chunks_exact(2).zip(&below).flat_map(|(d, l)| [d[0], 0.0, *l, d[1]]).collect();
        golden.check("control.cholesky", &cholesky, &golden.by_agent("control.cholesky", &agents));
    }
}

#[test]
fn future_graph_and_posterior_agree_with_the_reference() {
    for name in FOLDERS {
        let golden = Golden::open(name);
        let (history, ..) = golden.graph("history");
        let (future, rows, edges) = golden.graph("future");
        let history = encode(&golden.weights, &golden.config, &history, &mut Statistics::new());
        // The future's patches are not among the vectors, its nodes are.
        let node = floats(golden.rows("future.node", rows.iter().cloned()), [rows.len(), 64], &golden.device);
        let future = attend(&golden.weights, &golden.config, &future, node);
        check_encoded(&golden, &future, "future", &rows, &edges);
        let mean = posterior(&golden.weights, &history, &future);
        let theirs = golden.rows("latent.mean", golden.order.iter().map(|&agent| vec![agent]));
        golden.check("latent.mean", &host(mean), &theirs);
    }
}

#[test]
fn bicycles_agree_with_the_reference() {
    for name in FOLDERS {
        let golden = Golden::open(name);
        let vehicles: Vec<usize> =
            (0..golden.types.len()).filter(|&agent| golden.types[agent] == 0).collect();
        let mut config = golden.config.clone();
        (config.accel_limit_mps2, config.slip_rate_limit_radps, config.slip_limit_rad) = (5.0, 0.5, None);
        let (shape, _) = golden.tensor("control.mean");
        let rows = vehicles.len() * shape[0];
        let controls =
            floats(golden.by_agent("control.mean", &vehicles), [rows, shape[2], 2], &golden.device);
        let initial = golden.tensor("bicycle.initial").1;
        let column = |at: usize| {
            let of_vehicle = |vehicle: usize| std::iter::repeat_n(initial[vehicle * 5 + at], shape[0]);
            (0..vehicles.len()).flat_map(of_vehicle).collect::<Vec<f32>>()
        };
        let tensor = |values: Vec<f32>| floats(values, [rows, 1], &golden.device);
        let start = motion::VehicleStart {
            position_m: Tensor::cat(vec![tensor(column(0)), tensor(column(1))], 1),
            heading_rad: tensor(column(2)),
            speed_mps: tensor(column(3)),
            slip_rad: tensor(column(4)),
            rear_axle_m: tensor(vec![golden.scene["rear_axle_m"].as_f64().unwrap() as f32; rows]),
        };
        let numbers: Vec<usize> = (0..vehicles.len()).collect();
        for (integrator, tensor) in
            [(nn::Integrator::Euler, "bicycle.mean"), (nn::Integrator::Midpoint, "bicycle.midpoint_mean")]
        {
            config.integrator = integrator;
            let states = motion::drive(&config, &start, controls.clone());
            golden.check(tensor, &host(states), &golden.by_agent(tensor, &numbers));
        }
    }
}

#[test]
fn losses_agree_with_the_reference() {
    for name in FOLDERS {
        let golden = Golden::open(name);
        let tensor = |name: &str| {
            let (shape, values) = golden.tensor(name);
            floats(values, [shape[0], shape[1]], &golden.device)
        };
        let (posterior, prior) = (tensor("loss.posterior"), tensor("loss.prior"));
        golden.check("kl 1", &host(loss::kl(posterior.clone(), 1.0)), &golden.tensor("loss.kl_sigma_1").1);
        golden.check(
            "kl 0.5",
            &host(loss::kl(posterior.clone(), 0.5)),
            &golden.tensor("loss.kl_sigma_0.5").1,
        );
        golden.check("mmd", &host(loss::mmd(&posterior, &prior)), &golden.tensor("loss.mmd").1);
    }
}
