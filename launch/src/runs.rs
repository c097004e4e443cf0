//! The runs of this user that go on, by their names.

use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

use crate::failure::Failure;
use crate::observe::SOCKET;

/// Where the folders of runs lie, and what their names start with.
const ROOTS: &str = "/tmp";
const FAMILY: &str = "stgdat_";

/// A run whose launcher is alive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LivingRun {
    /// Its name: that of its folder.
    pub name: String,
    /// Its folder.
    pub root: PathBuf,
}

/// The runs whose launcher takes questions.
fn living() -> Result<Vec<LivingRun>, Failure> {
    let failed = |error| Failure::file(Path::new(ROOTS), error);
    let mut runs = Vec::new();
    for entry in std::fs::read_dir(ROOTS).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let (root, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        let is_ours = entry.metadata().is_ok_and(|m| m.uid() == rustix::process::geteuid().as_raw());
        // A launcher that was killed leaves its socket, on which nobody listens.
        if name.starts_with(FAMILY) && is_ours && UnixStream::connect(root.join(SOCKET)).is_ok() {
            runs.push(LivingRun { name, root });
        }
    }
    runs.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(runs)
}

/// The run of that name or with that folder; the only one where none is named.
pub fn find(name: Option<&Path>) -> Result<LivingRun, Failure> {
    let mut runs = living()?;
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
