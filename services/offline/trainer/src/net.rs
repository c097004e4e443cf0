//! The network as training sees it: every layer as a pair of functions, forward and backward.
//!
//! A forward function returns its result with a *trace* of what the way back needs. A backward function takes the
//! gradient of the loss by the result, adds to the [`Gradients`] of the weights and returns the gradients by the layer's
//! inputs. There is no tape: the model calls the layers backward in the order that it knows.
//!
//! The layers use the tensors of the weights file, under its names, and are held to finite differences, to the golden
//! vectors and to the onboard network.

#[cfg(test)]
pub(crate) mod check;
pub(crate) mod context;
pub(crate) mod dense;
pub(crate) mod file;
#[cfg(test)]
pub(crate) mod golden;
pub(crate) mod graph;
pub(crate) mod gru;
pub(crate) mod layout;
pub(crate) mod matrix;
pub(crate) mod motion;
pub(crate) mod score;
pub(crate) mod temporal;
pub(crate) mod tensors;
pub(crate) mod topological;
