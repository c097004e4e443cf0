//! Ports between stages: round trips between processes, relays and refused frames.

mod integrity;
mod relay;
mod round_trip;
mod turns;
