//! Tests of the whole program.

mod docs;
