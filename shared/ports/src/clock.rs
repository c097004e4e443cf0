use rustix::time::{ClockId, clock_gettime};

/// Now on `CLOCK_MONOTONIC`, which all processes of a machine share.
#[must_use]
pub fn monotonic_ns() -> u64 {
    now_ns(ClockId::Monotonic)
}

/// Unix time minus `CLOCK_MONOTONIC`.
#[must_use]
pub fn clock_offset_ns() -> i64 {
    let unix_ns = i64::try_from(now_ns(ClockId::Realtime)).unwrap_or(i64::MAX);
    unix_ns.saturating_sub_unsigned(monotonic_ns())
}

fn now_ns(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    // Neither part is negative on these clocks.
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
