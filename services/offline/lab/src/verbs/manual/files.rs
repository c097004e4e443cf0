//! Man pages and completions of `stgdat`, for its packages.

use std::path::Path;

use clap::{Command, ValueEnum as _};
use clap_complete::Shell;
use console::failure::Failure;

/// Writes `man1/stgdat.1`, a page for each verb of `stgdat` in the same folder, and the completions for shells.
pub fn write(folder: &Path) -> Result<(), Failure> {
    let pages = folder.join("man1");
    std::fs::create_dir_all(&pages)
        .and_then(|()| clap_mangen::generate_to(program(), &pages))
        .map_err(|error| Failure::output(&pages, error))?;
    for &shell in Shell::value_variants() {
        clap_complete::generate_to(shell, &mut launch::command(), "stgdat", folder)
            .map_err(|error| Failure::output(folder, error))?;
    }
    Ok(())
}

/// The command line of `stgdat` without the verbs of other programs, which may not be installed.
fn program() -> Command {
    let hide =
        |program: Command, verb: &Command| program.mut_subcommand(verb.get_name(), |verb| verb.hide(true));
    super::verbs_of_others().iter().fold(launch::command(), hide)
}

#[cfg(test)]
mod tests {
    use testing::Scratch;

    use super::*;

    #[test]
    fn each_verb_of_stgdat_has_a_man_page() {
        let scratch = Scratch::new("manual");
        let folder = std::path::PathBuf::from(scratch.path("package"));
        write(&folder).unwrap();
        let page = |name: &str| std::fs::read_to_string(folder.join("man1").join(name));
        for verb in program().get_subcommands() {
            let page = page(&format!("stgdat-{}.1", verb.get_name()));
            assert_eq!(page.is_ok(), !verb.is_hide_set(), "{}", verb.get_name());
        }
        assert!(page("stgdat-stage-new.1").is_ok(), "verbs of verbs");
        assert!(page("stgdat-run.1").unwrap().contains(r"\fB\-\-ticks\fR"));
        let main = page("stgdat.1").unwrap();
        assert!(main.contains("stgdat\\-health(1)") && !main.contains("train"), "{main}");
        for name in ["stgdat.bash", "_stgdat", "stgdat.fish"] {
            assert!(std::fs::read_to_string(folder.join(name)).unwrap().contains("health"), "{name}");
        }
    }
}
