/// The part of a header that the forecasts depend on.
#[derive(Clone, Copy, Default)]
pub(crate) struct Tick {
    pub(crate) stamp_ns: i64,
    pub(crate) seq: u64,
    pub(crate) step_ns: u64,
}

impl Tick {
    pub(crate) fn dt_s(&self) -> f32 {
        (self.step_ns as f64 * 1e-9) as f32
    }
}
