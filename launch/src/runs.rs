//! The current user's running pipelines, by name.

use std::path::Path;

use ports::LivingRun;
use recording::About;

use crate::failure::Failure;

/// Finds the run with this name or folder; without a name, the only run.
pub fn find(name: Option<&Path>) -> Result<LivingRun, Failure> {
    choose(ports::living_runs().map_err(Failure::unavailable)?, name)
}

fn choose(mut runs: Vec<LivingRun>, name: Option<&Path>) -> Result<LivingRun, Failure> {
    let is_it = |run: &LivingRun| name.is_none_or(|name| Path::new(&run.name) == name || run.root == name);
    match (name, runs.iter().filter(|run| is_it(run)).count()) {
        (_, 1) => {
            let place = runs.iter().position(is_it).unwrap_or_default();
            Ok(runs.swap_remove(place))
        }
        (Some(name), _) => {
            Err(Failure::Usage(format!("there is no run {}; {}", name.display(), listed(&runs))))
        }
        (None, 0) => Err(Failure::Usage(format!("{}: `stgdat run` starts one", listed(&runs)))),
        (None, len) => {
            Err(Failure::Usage(format!("{len} runs are running: name one with --run; {}", listed(&runs))))
        }
    }
}

/// Lists the runs and their inputs.
fn listed(runs: &[LivingRun]) -> String {
    let each = runs.iter().map(|run| match About::of_run(&run.root) {
        Ok(about) => format!("{} ({})", run.name, about.scene),
        Err(_) => run.name.clone(),
    });
    let each: Vec<String> = each.collect();
    if each.is_empty() { "no run is running".to_owned() } else { format!("running: {}", each.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn runs(names: &[&str]) -> Vec<LivingRun> {
        let run =
            |name: &&str| LivingRun { name: (*name).to_owned(), root: Path::new("/nowhere").join(name) };
        names.iter().map(run).collect()
    }

    #[test]
    fn one_of_several_runs_is_never_chosen_without_its_name() {
        assert_eq!(choose(runs(&["a"]), None).unwrap().name, "a");
        let several = || runs(&["a", "b", "c"]);
        assert_eq!(choose(several(), Some(Path::new("b"))).unwrap().name, "b");
        assert_eq!(choose(several(), Some(Path::new("/nowhere/c"))).unwrap().name, "c");
        let error = |runs, name| choose(runs, name).unwrap_err().to_string();
        assert_eq!(error(several(), None), "3 runs are running: name one with --run; running: a, b, c");
        assert_eq!(error(several(), Some(Path::new("d"))), "there is no run d; running: a, b, c");
        assert_eq!(error(runs(&["a"]), Some(Path::new("d"))), "there is no run d; running: a");
        assert_eq!(error(runs(&[]), None), "no run is running: `stgdat run` starts one");
    }
}
