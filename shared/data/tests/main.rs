//! Readers: recordings as published, windows, and files that must be refused.

mod bad_input;
mod recordings;
mod windows;
