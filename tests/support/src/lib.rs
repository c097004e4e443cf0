//! Helpers that the tests of several crates share.
//!
//! * [`public_recording`] finds recordings that are not part of the repository. If a recording is missing,
//!   its tests return early, or fail if `STGDAT_REQUIRE_DATA=1` is set.
//! * [`skip`] lists such tests, with the reason, at the end of the test program.
//! * [`CountingAllocator`] counts allocations, for tests that assert that a steady step makes none.
//! * [`Model`] makes weights files from the embedded one.
//! * [`Browser`] is a page in headless Chromium.
//! * [`lane`] is a map of one lane.
//! * [`Scratch`] is the folder of a test, with generated recordings and changed pipelines.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

mod allocation;
mod browser;
mod lane;
mod model;
mod recordings;
mod scratch;
mod skipped;

pub use allocation::{AllocationCounts, CountingAllocator, THREADS_MAX, allocations};
pub use browser::Browser;
pub use lane::lane;
pub use model::{Model, value};
pub use recordings::{public_recording, recordings_folder};
pub use scratch::{SHIPPED_PIPELINE, Scratch};
pub use skipped::skip;
