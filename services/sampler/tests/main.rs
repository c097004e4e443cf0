//! Tests of the sampler's public interface: forecasts of every quality and with several modes, and the state
//! that outlives its process.

mod journal;
mod modes;
mod road;
mod sampler;
mod workers;
