//! The whole pipeline from outside: `stgdat` as its users start it.

mod bad_input;
mod endings;
mod lockstep;
mod options;
mod programs;
mod recordings;
mod scratch;
mod started;
mod tracks;
mod wire_layout;
