//! The golden vectors: outputs of an independent float64 implementation.

use std::path::PathBuf;

use nn::ModelConfig;
use safetensors::SafeTensors;
use serde_json::Value;

use crate::net::tensors::{TensorRole, Tensors};
use crate::net::topological::Edges;

const FOLDERS: [&str; 4] = ["vehicle", "pedestrian", "plus", "literal"];
const TYPE_NAMES: [&str; 3] = ["vehicle", "cyclist", "pedestrian"];
/// Maximum error, relative to the largest value.
const TOLERANCE: f32 = 1e-4;

/// One golden folder: a model, a scene and all intermediate tensors.
pub(crate) struct Golden {
    pub(crate) name: &'static str,
    pub(crate) config: ModelConfig,
    pub(crate) weights: Tensors,
    pub(crate) scene: Value,
    /// Type of every agent: vehicle, cyclist or pedestrian.
    pub(crate) types: Vec<usize>,
    tensors: Vec<u8>,
}

/// The graph of the history or the future.
pub(crate) struct GoldenGraph {
    /// (step, agent) of every row, agent by agent.
    pub(crate) rows: Vec<Vec<usize>>,
    /// (step, receiver, sender) of every edge.
    pub(crate) joined: Vec<Vec<usize>>,
    pub(crate) edges: Edges,
    /// Row of every agent and step, `u32::MAX` where absent.
    pub(crate) steps: Vec<u32>,
    pub(crate) step_count: usize,
}

impl Golden {
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        FOLDERS.into_iter().map(Self::open)
    }

    fn open(name: &'static str) -> Self {
        let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../tests/golden")).join(name);
        let read = |file: &str| std::fs::read(folder.join(file)).unwrap();
        let bytes = read("weights.safetensors");
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let config = serde_json::from_str(&header.metadata().as_ref().unwrap()["config"]).unwrap();
        let mut weights = Tensors::default();
        for (name, view) in SafeTensors::deserialize(&bytes).unwrap().iter() {
            let role = if name.contains(".running_") { TensorRole::Statistic } else { TensorRole::Learned };
            weights.insert(name, view.shape(), floats(view.data()), role);
        }
        let scene: Value = serde_json::from_slice(&read("scene.json")).unwrap();
        let type_of = |name: &Value| TYPE_NAMES.iter().position(|known| name == known).unwrap();
        let types = scene["types"].as_array().unwrap().iter().map(type_of).collect();
        Self { name, config, weights, scene, types, tensors: read("tensors.safetensors") }
    }

    /// Shape and values of a tensor.
    pub(crate) fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        let file = SafeTensors::deserialize(&self.tensors).unwrap();
        let view = file.tensor(name).unwrap();
        (view.shape().to_vec(), floats(view.data()))
    }

    /// Values of `name` at these leading indices. Each index selects a slice of the remaining dimensions.
    pub(crate) fn rows(&self, name: &str, indices: impl IntoIterator<Item = Vec<usize>>) -> Vec<f32> {
        let (shape, values) = self.tensor(name);
        let mut rows = Vec::new();
        for index in indices {
            let width: usize = shape[index.len()..].iter().product();
            let row = index.iter().zip(&shape).fold(0, |row, (i, len)| row * len + i);
            rows.extend_from_slice(&values[row * width..][..width]);
        }
        rows
    }

    /// Asserts that `found` equals `expected` within the tolerance.
    pub(crate) fn check(&self, name: &str, found: &[f32], expected: &[f32]) {
        assert_eq!(found.len(), expected.len(), "{} {name}: length", self.name);
        let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
        let worst = found.iter().zip(expected).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(worst <= TOLERANCE * largest, "{} {name}: off by {worst} of {largest}", self.name);
    }

    /// Whether an agent is present at a step of the scene; the future's steps follow the history's.
    pub(crate) fn present(&self, step: usize, agent: usize) -> bool {
        self.scene["present"][step][agent].as_bool().unwrap()
    }

    /// The graph of `history` or `future`.
    pub(crate) fn graph(&self, part: &str) -> GoldenGraph {
        let (shape, adjacency) = self.tensor(&format!("{part}.adjacency"));
        let (step_count, agents_len) = (shape[0], shape[1]);
        let start = if part == "history" { 0 } else { self.config.history_len };
        let (mut rows, mut steps) = (Vec::new(), Vec::new());
        for agent in 0..agents_len {
            for step in 0..step_count {
                let present = self.present(start + step, agent);
                steps.push(if present { rows.len() as u32 } else { u32::MAX });
                if present {
                    rows.push(vec![step, agent]);
                }
            }
        }
        let mut edges = Edges { receiver: Vec::new(), sender: Vec::new(), first: vec![0] };
        let mut joined = Vec::new();
        for (number, row) in rows.iter().enumerate() {
            let (step, receiver) = (row[0], row[1]);
            for sender in 0..agents_len {
                if adjacency[(step * agents_len + receiver) * agents_len + sender] > 0.0 {
                    joined.push(vec![step, receiver, sender]);
                    edges.receiver.push(number as u32);
                    edges.sender.push(steps[sender * step_count + step]);
                }
            }
            edges.first.push(joined.len() as u32);
        }
        GoldenGraph { rows, joined, edges, steps, step_count }
    }
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}
