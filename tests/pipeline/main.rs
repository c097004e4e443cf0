//! The whole pipeline from outside: the program `stgdat` and its stages as processes.

mod bad_input;
mod endings;
mod fault_runs;
mod faults;
mod lockstep;
mod options;
mod programs;
mod projects;
mod python;
mod recordings;
mod replacements;
mod scratch;
mod started;
mod tracks;
mod wire_layout;
