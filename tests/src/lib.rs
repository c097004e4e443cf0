//! Tests of the project from outside.
//!
//! | folder | content |
//! |---|---|
//! | `golden/` | vectors of an independent reference |
//! | `fuzz/` | one fuzz target per reader |
//! | `allocation/` | counts of the allocations in the stages' loops |
//! | `examples/` | programs as users write them, in their own crate |
//! | `pipeline/` | tests of whole runs, built with the program `stgdat`, which they start |
//! | `support/` | helpers that tests of several crates share |
