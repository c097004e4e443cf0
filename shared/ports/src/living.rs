//! The choice of one of the user's running pipelines.

use std::path::Path;

use crate::LivingRun;

/// Chooses the run with this name or folder; without a name, the only run. `describe` is the text of a run in
/// lists.
///
/// # Errors
/// Why no run is chosen, with the list of the runs.
pub fn choose_run(
    mut runs: Vec<LivingRun>,
    name: Option<&Path>,
    describe: impl Fn(&LivingRun) -> String,
) -> Result<LivingRun, String> {
    let is_it = |run: &LivingRun| name.is_none_or(|name| Path::new(&run.name) == name || run.root == name);
    let listed = |runs: &[LivingRun]| {
        let each: Vec<String> = runs.iter().map(&describe).collect();
        if each.is_empty() { "no run is running".to_owned() } else { format!("running: {}", each.join(", ")) }
    };
    match (name, runs.iter().filter(|run| is_it(run)).count()) {
        (_, 1) => {
            let place = runs.iter().position(is_it).unwrap_or_default();
            Ok(runs.swap_remove(place))
        }
        (Some(name), _) => Err(format!("there is no run {}; {}", name.display(), listed(&runs))),
        (None, 0) => Err(format!("{}: `stgdat run` starts one", listed(&runs))),
        (None, len) => Err(format!("{len} runs are running: name one with --run; {}", listed(&runs))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn runs(names: &[&str]) -> Vec<LivingRun> {
        let run =
            |name: &&str| LivingRun { name: (*name).to_owned(), root: Path::new("/nowhere").join(name) };
        names.iter().map(run).collect()
    }

    fn choose(runs: Vec<LivingRun>, name: Option<&Path>) -> Result<LivingRun, String> {
        choose_run(runs, name, |run| run.name.clone())
    }

    #[test]
    fn one_of_several_runs_is_never_chosen_without_its_name() {
        assert_eq!(choose(runs(&["a"]), None).unwrap().name, "a");
        let several = || runs(&["a", "b", "c"]);
        assert_eq!(choose(several(), Some(Path::new("b"))).unwrap().name, "b");
        assert_eq!(choose(several(), Some(Path::new("/nowhere/c"))).unwrap().name, "c");
        let error = |runs, name| choose(runs, name).unwrap_err();
        assert_eq!(error(several(), None), "3 runs are running: name one with --run; running: a, b, c");
        assert_eq!(error(several(), Some(Path::new("d"))), "there is no run d; running: a, b, c");
        assert_eq!(error(runs(&["a"]), Some(Path::new("d"))), "there is no run d; running: a");
        assert_eq!(error(runs(&[]), None), "no run is running: `stgdat run` starts one");
    }
}
