//! The whole pipeline from outside: the program `stgdat` and its stages as processes.

mod bad_input;
mod endings;
mod fault_runs;
mod faults;
mod lockstep;
mod observing;
mod options;
mod programs;
mod recordings;
mod scratch;
mod started;
mod tracks;
mod wire_layout;
