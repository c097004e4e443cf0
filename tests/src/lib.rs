//! What tries the project from outside.
//!
//! `golden/` holds the vectors of an independent reference, `fuzz/` a target per reader, `allocation/` the
//! count of what the stages' loops allocate, `examples/` programs as users write them (a crate of its own),
//! `pipeline/` the tests of whole runs (built with the `stgdat` program, whose executable they start), and
//! `support/` what tests of several crates share.
