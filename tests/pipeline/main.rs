//! The whole pipeline from outside: the program `stgdat` and its stages as processes.

mod audit;
mod bad_input;
mod daily;
mod endings;
mod fault_runs;
mod faults;
mod frames;
mod live;
mod lockstep;
mod observing;
mod options;
mod origins;
mod programs;
mod projects;
mod python;
mod readers;
mod real_time;
mod recorded;
mod recordings;
mod replacements;
mod shedding;
mod spares;
mod started;
mod torn;
mod tracks;
mod wire_layout;
