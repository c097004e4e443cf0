//! Offline checks of the pipeline's parts against references.
//!
//! [`verify`] recomputes every tensor of a folder of golden vectors with the very code that runs on board and tells
//! which ones are off: users run it on their own processor before they trust it.

mod verify;

pub use verify::{Comparison, TOLERANCE, VerifyError, verify};
