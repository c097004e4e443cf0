//! Golden vectors for tests.
