//! Supervision of a run: starts the processes of the stages, watches them, starts them again after a death,
//! replaces them, and ends them.
//!
//! [`Fleet::tend`] is the centre. The launcher calls it at least every 50 ms. One call
//!
//! 1. finds the processes that have ended, and asks `policy` whether each is started again;
//! 2. examines stages that send no heartbeats (`health`), and kills those that hang or are stopped;
//! 3. starts the stages that are due, once their dead predecessors are cleaned up (`cleaner`).
//!
//! **Nothing here waits without a limit.** Programs are started by another thread within a time limit (`spawn`).
//! Output passes through queues with a limit (`outlet`), and the output of the stages is read by a thread of its
//! own (`stage_output`). A process that can't be killed is reported and left behind.
//!
//! # Modules
//!
//! Each module imports only from the lines below its own.
//!
//! ```text
//! fleet                 the processes of a run: tend, replace, spares, end
//! readers               deaths of readers that are not stages
//! cleaner               the clean-up after dead processes
//! child                 one process of a stage
//! control  spawn  stage_output    orders; starts within a limit; the output of the stages
//! policy  processes     when a stage is started again; use of CPU and memory
//! health  restart  scheduling  outlet  text  program
//! error
//! ```

mod child;
mod cleaner;
pub mod control;
mod error;
mod fleet;
mod health;
mod outlet;
mod policy;
mod processes;
mod program;
mod readers;
mod restart;
pub mod scheduling;
mod spawn;
mod stage_output;
mod text;

pub use child::{KILL_LIMIT, Program, die_with_this_process, end_within};
pub use cleaner::line as helper_line;
pub use error::{Cause, Error, StageDeath, cause_about};
pub use fleet::{CheckOptions, Event, Fleet, Process, Replaced, Settings, StageSettings};
pub use health::look;
pub use outlet::{BYTES_MAX as QUEUE_BYTES_MAX, Origin, Outlet, Queue};
pub use processes::{Usage, Used, children, memory};
pub use program::this_program;
pub use restart::{Restart, RestartPolicy};
pub use scheduling::Scheduling;
pub use spawn::spawn;
pub use stage_output::Sink;
pub use text::{message, parse, plain};

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    /// The line of each module in the table above.
    fn line_of(module: &str) -> Option<usize> {
        let table = include_str!("lib.rs").split("```").nth(1).expect("the table is there");
        table
            .lines()
            .skip(1)
            .position(|line| line.trim_start_matches("//! ").split("  ").any(|word| word.trim() == module))
    }

    fn files(folder: &Path) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).expect("the sources are there");
        let paths = entries.map(|entry| entry.expect("it can be read").path());
        paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
    }

    #[test]
    fn no_module_imports_from_its_own_line_or_above() {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        for path in files(&source) {
            let own = path.strip_prefix(&source).expect("it is below").with_extension("");
            let own = own.iter().next().and_then(|name| name.to_str()).expect("it has a name");
            if own == "lib" {
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("it is text");
            let text = text.split("#[cfg(test)]").next().unwrap_or_default();
            let line = line_of(own).unwrap_or_else(|| panic!("{own} is not in the table"));
            for used in text.split("use crate::").skip(1) {
                let used = used.split([':', ';']).next().unwrap_or_default();
                let below = line_of(used).unwrap_or_else(|| panic!("{used} is not in the table"));
                assert!(own == used || below > line, "{own} imports from {used}");
            }
        }
    }
}
