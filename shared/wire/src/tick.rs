/// The tick: the interval between frames at 12.5 Hz, the rate that the pipeline is built for. Faster input is
/// thinned to this rate.
pub const TICK_NS: u64 = 80_000_000;
/// [`TICK_NS`] in milliseconds.
pub const TICK_MS: f64 = TICK_NS as f64 / 1e6;
