//! Named tensors: the weights of a model and the gradients of a loss by them.

use std::collections::BTreeMap;

use super::matrix::{View, ViewMut};

/// How training changes a tensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TensorRole {
    /// Learned along its gradient.
    Learned,
    /// Running mean or variance of a batch norm.
    Statistic,
    /// Fitted before training (base control) and then constant.
    Fixed,
}

/// One tensor, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
    pub(crate) role: TensorRole,
}

/// All weights of a model, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tensors(pub(crate) BTreeMap<String, Tensor>);

impl Tensors {
    /// Adds or replaces a tensor.
    pub(crate) fn insert(&mut self, name: &str, shape: &[usize], values: Vec<f32>, role: TensorRole) {
        assert_eq!(values.len(), shape.iter().product::<usize>(), "`{name}` does not fill {shape:?}");
        self.0.insert(name.to_owned(), Tensor { shape: shape.to_vec(), values, role });
    }

    /// # Panics
    /// If the model has no such tensor: `layout` lists the names.
    pub(crate) fn tensor(&self, name: &str) -> &Tensor {
        self.0.get(name).unwrap_or_else(|| panic!("the model has no tensor `{name}`"))
    }

    /// The values of a tensor. Panics as [`Tensors::tensor`] does.
    pub(crate) fn get(&self, name: &str) -> &[f32] {
        &self.tensor(name).values
    }

    /// These tensors, moved by `share` towards others with the same names and shapes.
    pub(crate) fn moved(mut self, to: &Self, share: f32) -> Self {
        for (tensor, to) in self.0.values_mut().zip(to.0.values()) {
            tensor.values.iter_mut().zip(&to.values).for_each(|(value, to)| *value += share * (to - *value));
        }
        self
    }

    /// A tensor as a matrix: its first dimension by all others.
    pub(crate) fn matrix(&self, name: &str) -> View<'_> {
        let tensor = self.tensor(name);
        View::new(&tensor.values, tensor.shape[0], tensor.shape[1..].iter().product())
    }
}

/// The gradients of a loss by the learned tensors.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Gradients(pub(crate) BTreeMap<String, (usize, Vec<f32>)>);

impl Gradients {
    /// Zeros for every learned tensor.
    pub(crate) fn zeros(weights: &Tensors) -> Self {
        let learned = weights.0.iter().filter(|(_, tensor)| tensor.role == TensorRole::Learned);
        let zeros = learned.map(|(name, tensor)| {
            let rows = tensor.shape.first().copied().unwrap_or(1);
            (name.clone(), (rows, vec![0.0; tensor.values.len()]))
        });
        Self(zeros.collect())
    }

    /// # Panics
    /// If no learned tensor has this name.
    pub(crate) fn get_mut(&mut self, name: &str) -> &mut [f32] {
        &mut self.0.get_mut(name).unwrap_or_else(|| panic!("no learned tensor `{name}`")).1
    }

    /// A gradient as a matrix: its first dimension by all others. Panics as [`Gradients::get_mut`] does.
    pub(crate) fn matrix_mut(&mut self, name: &str) -> ViewMut<'_> {
        let (rows, values) = self.0.get_mut(name).unwrap_or_else(|| panic!("no learned tensor `{name}`"));
        let cols = values.len() / *rows;
        ViewMut::new(values, *rows, cols)
    }

    /// Adds the gradients of another part of the batch.
    pub(crate) fn add(&mut self, other: &Self) {
        for ((_, sum), (_, part)) in self.0.values_mut().zip(other.0.values()) {
            sum.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
        }
    }
}
