//! The network: golden vectors, properties of layers, and weights files.

mod golden;
mod properties;
mod weights;
