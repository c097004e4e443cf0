//! The sampler by its public interface: forecasts of every quality, and of several modes; what outlives its process.

mod journal;
mod modes;
mod road;
mod sampler;
mod workers;
