//! What stands for a GPU in a build without the feature `gpu`: there is none, and none is opened.

use super::super::matrix::Matrix;
use super::super::tensors::{Gradients, Tensors};
use super::unroll::{Inputs, UnrollGradients};
use crate::TrainError;

/// No GPU.
#[derive(Debug)]
pub(crate) enum Gpu {}

/// Nothing that lies on one.
#[derive(Debug)]
pub(crate) enum Trace {}

impl Gpu {
    /// # Errors
    /// Always.
    pub(crate) fn open() -> Result<Self, TrainError> {
        let reason = "this build has no GPU backend; build with `--features gpu`".to_owned();
        Err(TrainError::Gpu { reason })
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
