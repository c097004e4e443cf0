//! The GPU of a build without the feature `gpu`: opening one is an error.

use super::super::matrix::Matrix;
use super::super::tensors::{Gradients, Tensors};
use super::unroll::{Inputs, UnrollGradients};
use crate::TrainError;

/// No GPU.
#[derive(Debug)]
pub(crate) enum Gpu {}

/// No trace.
#[derive(Debug)]
pub(crate) enum Trace {}

impl Gpu {
    /// # Errors
    /// Always.
    pub(crate) fn open() -> Result<Self, TrainError> {
        Err(TrainError::Gpu { source: "this build has no GPU backend; build with `--features gpu`".into() })
    }

    pub(crate) fn name(&self) -> &str {
        match *self {}
    }

    pub(super) fn unroll(
        &self,
        _: &Tensors,
        _: (&str, &Matrix, usize),
        _: &[f32],
        _: usize,
        _: Option<Inputs>,
    ) -> (Matrix, Option<Trace>) {
        match *self {}
    }

    pub(super) fn backward(&self, _: &Trace, _: &Tensors, _: &mut Gradients, _: &Matrix) -> UnrollGradients {
        match *self {}
    }
}
