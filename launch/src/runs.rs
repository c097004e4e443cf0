//! The current user's running pipelines, by name.

use std::path::Path;

use ports::LivingRun;
use recording::About;

use crate::failure::Failure;

/// Finds the run with this name or folder; without a name, the only run.
pub fn find(name: Option<&Path>) -> Result<LivingRun, Failure> {
    let runs = ports::living_runs().map_err(Failure::unavailable)?;
    ports::choose_run(runs, name, described).map_err(Failure::Usage)
}

/// A run with its input.
fn described(run: &LivingRun) -> String {
    match About::of_run(&run.root) {
        Ok(about) => format!("{} ({})", run.name, about.scene),
        Err(_) => run.name.clone(),
    }
}
