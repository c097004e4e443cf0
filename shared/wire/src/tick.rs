/// The tick: the interval between frames at 12.5 Hz, for which the pipeline is built. What comes faster is
/// thinned to it.
pub const TICK_NS: u64 = 80_000_000;
/// [`TICK_NS`] in milliseconds.
pub const TICK_MS: f64 = TICK_NS as f64 / 1e6;
