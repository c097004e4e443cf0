//! Tests of the records.

pub(crate) mod distinct;
