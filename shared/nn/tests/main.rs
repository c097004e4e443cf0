//! The network: properties of layers, and weights files.

mod properties;
mod weights;
