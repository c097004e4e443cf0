//! The runs of this user that go on, by their names.

use std::path::Path;

use ports::LivingRun;

use crate::failure::Failure;

/// The run of that name or with that folder; the only one where none is named.
pub fn find(name: Option<&Path>) -> Result<LivingRun, Failure> {
    let mut runs = ports::living_runs().map_err(Failure::unavailable)?;
    let names: Vec<&str> = runs.iter().map(|run| run.name.as_str()).collect();
    let listed = if names.is_empty() {
        "no run goes on".to_owned()
    } else {
        format!("runs that go on: {}", names.join(", "))
    };
    match name {
        Some(name) => {
            let is_it = |run: &LivingRun| Path::new(&run.name) == name || run.root == name;
            let place = runs.iter().position(is_it);
            let place = place
                .ok_or_else(|| Failure::Usage(format!("there is no run {}; {listed}", name.display())))?;
            Ok(runs.swap_remove(place))
        }
        None if runs.len() == 1 => Ok(runs.swap_remove(0)),
        None if runs.is_empty() => Err(Failure::Usage(format!("{listed}: `stgdat run` starts one"))),
        None => Err(Failure::Usage(format!("{listed}: name one with --run"))),
    }
}
