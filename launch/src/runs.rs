//! The current user's running pipelines, by name.

use std::path::Path;

use ports::{ForeignRun, LivingRun};
use recording::About;

use console::failure::Failure;

/// Finds the run with this name or folder; without a name, the only run.
pub fn find(name: Option<&Path>) -> Result<LivingRun, Failure> {
    let runs = ports::living_runs().map_err(Failure::unavailable)?;
    let foreign = ports::foreign_runs().map_err(Failure::unavailable)?;
    ports::choose_run(runs, name, described).map_err(|text| Failure::Usage(text + &of_others(&foreign)))
}

/// Lists the runs of other users; empty if there are none.
fn of_others(runs: &[ForeignRun]) -> String {
    let each: Vec<String> = runs.iter().map(|run| format!("{} of user {}", run.name, run.user)).collect();
    match each.is_empty() {
        true => String::new(),
        false => format!("; runs of other users, which only they can open: {}", each.join(", ")),
    }
}

/// A run with its input.
fn described(run: &LivingRun) -> String {
    match About::of_run(&run.root) {
        Ok(about) => format!("{} ({})", run.name, about.scene),
        Err(_) => run.name.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_other_users_are_named() {
        assert_eq!(of_others(&[]), "");
        let others = of_others(&[ForeignRun { name: "stgdat_1".to_owned(), user: 1001 }]);
        assert_eq!(others, "; runs of other users, which only they can open: stgdat_1 of user 1001");
    }
}
