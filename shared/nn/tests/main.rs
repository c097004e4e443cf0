//! The network: properties of layers, weights files, and the emitted code.

mod emitted;
mod properties;
mod weights;
