use rustix::time::{ClockId, clock_gettime};

/// Now on `CLOCK_MONOTONIC`, which all processes of a machine share.
#[must_use]
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    // Neither part is negative on this clock.
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
