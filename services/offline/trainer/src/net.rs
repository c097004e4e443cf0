//! The network in training: every layer as a pair of functions, forward and backward pass. \[model §3\]
//!
//! A forward function returns its result and a *trace* for the backward pass. A backward function takes the
//! gradient of the loss by the result. It adds to the [`Gradients`] of the weights and returns the gradients
//! by the layer's inputs. There is no tape: the model calls the layers backward in a fixed order.
//!
//! The layers use the tensors of the weights file under the same names. Tests compare them with finite
//! differences, with the golden vectors and with the onboard network.

pub(crate) mod context;
pub(crate) mod dense;
pub(crate) mod file;
pub(crate) mod graph;
pub(crate) mod gru;
pub(crate) mod layout;
pub(crate) mod matrix;
pub(crate) mod motion;
pub(crate) mod score;
pub(crate) mod temporal;
pub(crate) mod tensors;
pub(crate) mod topological;
