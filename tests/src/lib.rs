//! What tries the project from outside.
//!
//! `golden/` holds the vectors of an independent reference, `fuzz/` a target per reader, `examples/` programs as users write
//! them, `pipeline/` the tests of whole runs (built with the `stgdat` program, whose executable they start), and `support/`
//! what tests of several crates share.
