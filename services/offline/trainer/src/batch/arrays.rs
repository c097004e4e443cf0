//! A batch as plain arrays, for other programs.

use nn::ModelConfig;

use super::{Batch, Graph};
use crate::agent_view::SceneView;
use crate::net::matrix::Matrix;
use crate::objective::Draws;

/// An array in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Name, see [`Windows::batch`](crate::Windows::batch).
    pub name: String,
    /// Length of each axis.
    pub shape: Vec<usize>,
    /// The values.
    pub values: Values,
}

/// The values of an array.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Quantities.
    Numbers(Vec<f32>),
    /// Numbers of rows, types and modes, and flags.
    Indices(Vec<i64>),
}

/// Arrays while they are collected.
#[derive(Default)]
struct Arrays(Vec<Array>);

impl Arrays {
    fn numbers(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        self.push(name, shape, Values::Numbers(values.to_vec()));
    }

    fn indices(&mut self, name: &str, shape: &[usize], values: impl Iterator<Item = i64>) {
        self.push(name, shape, Values::Indices(values.collect()));
    }

    fn push(&mut self, name: &str, shape: &[usize], values: Values) {
        self.0.push(Array { name: name.to_owned(), shape: shape.to_vec(), values });
    }

    /// The arrays of a graph whose rows are agent · steps + step.
    fn graph(&mut self, prefix: &str, graph: &Graph, patch_side: usize) {
        let steps = graph.step_count;
        let agents = graph.steps.len() / steps;
        let name = |of: &str| format!("{prefix}.{of}");
        let mut node_of_row = vec![0; graph.state.rows];
        let mut state = Matrix::zeros(agents * steps, graph.state.cols);
        let present = |row: u32| row != u32::MAX;
        for (node, &row) in graph.steps.iter().enumerate().filter(|&(_, &row)| present(row)) {
            node_of_row[row as usize] = node as i64;
            state.row_mut(node).copy_from_slice(graph.state.row(row as usize));
        }
        self.numbers(&name("state"), &[agents, steps, state.cols], &state.values);
        self.indices(
            &name("present"),
            &[agents, steps],
            graph.steps.iter().map(|&row| i64::from(present(row))),
        );
        for (end, rows) in [("receiver", &graph.edges.receiver), ("sender", &graph.edges.sender)] {
            self.indices(&name(end), &[rows.len()], rows.iter().map(|&row| node_of_row[row as usize]));
        }
        let relations = &graph.relation_of_edge;
        self.indices(&name("relation_of_edge"), &[relations.len()], relations.iter().map(|&of| of.into()));
        self.numbers(&name("relation"), &[graph.relation.rows, graph.relation.cols], &graph.relation.values);
        if graph.patches.rows > 0 {
            let patch = |&row: &u32| if present(row) { graph.patch_of_row[row as usize].into() } else { 0 };
            self.indices(&name("patch_of_node"), &[agents, steps], graph.steps.iter().map(patch));
            let shape = [graph.patches.rows, 3, patch_side, patch_side];
            self.numbers(&name("patches"), &shape, &graph.patches.values);
        }
    }
}

impl Batch<'_> {
    /// All arrays of the batch of these scenes.
    pub(crate) fn arrays(&self, scenes: &[SceneView<'_>], config: &ModelConfig, draws: &Draws) -> Vec<Array> {
        let mut arrays = Arrays::default();
        let agents = || self.origin.iter().map(|&(scene, agent)| &scenes[scene].agents[agent]);
        let len = self.origin.len();
        arrays.indices("types", &[len], agents().map(|view| view.agent.agent_type as i64));
        arrays.indices("forecast", &[len], agents().map(|view| i64::from(view.counts)));
        let length_m: Vec<f32> = agents().map(|view| view.agent.length_m.unwrap_or_default()).collect();
        arrays.numbers("length_m", &[len], &length_m);
        arrays.numbers("truth_m", &[len, config.horizon_len, 2], &self.truth.values);
        arrays.indices("known", &[len, config.horizon_len], self.counts.values.iter().map(|&of| of as i64));
        arrays.graph("history", &self.graph, config.patch_size);
        if let Some(future) = &self.future {
            arrays.graph("future", future, config.patch_size);
        }
        let counted = self.forecast.iter().map(ExactSizeIterator::len).sum();
        let shape = if draws.modes.is_empty() {
            vec![2, counted, draws.noise[0].cols]
        } else {
            arrays.indices("random_mode", &[counted], draws.modes.iter().map(|&mode| mode as i64));
            vec![2, counted, draws.noise[0].rows / counted, config.horizon_len, 2]
        };
        arrays.numbers("noise", &shape, &draws.noise.each_ref().map(|noise| &noise.values[..]).concat());
        arrays.0
    }
}
