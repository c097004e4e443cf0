//! The sampler by its public interface: forecasts of every quality, and of several modes.

mod modes;
mod road;
mod sampler;
