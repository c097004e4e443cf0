use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use run::Exit;

use configuration::options::absolute;
use configuration::pipeline_file;
use console::failure::Failure;
use console::show::show;

/// The repository from which this program was built, if it still exists. A package names no folder of the machine
/// that built it.
const BUILT_FROM: &str = match option_env!("STGDAT_REPOSITORY") {
    Some(folder) => folder,
    None => concat!(env!("CARGO_MANIFEST_DIR"), "/.."),
};
/// Dependencies of each stage project: the repository's crates, and crates whose types they expose.
const DEPENDENCIES: &str = "\
bytemuck = { version = \"1.24\", features = [\"derive\", \"min_const_generics\"] }
serde = { version = \"1\", features = [\"derive\"] }
";
/// Crates of the repository that a stage uses, in folder `shared`.
const OURS: [&str; 4] = ["model", "ports", "run", "wire"];
/// Files of the repository that pin the project's dependencies and compiler.
const PINNED: [&str; 2] = ["Cargo.lock", "rust-toolchain.toml"];

/// Arguments of `stgdat stage new`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name of the project, and of its folder
    name: String,
    /// Template of the project
    #[arg(long, value_enum, default_value = "localiser")]
    of: Template,
    /// Folder in which to create the project's folder
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    /// Repository of stgdat: a folder, or the URL of a git repository; by default the folder from which this
    /// program was built
    #[arg(long, value_name = "PATH|URL")]
    repository: Option<String>,
}

/// What a project begins as: the examples of the repository.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Template {
    /// A localiser: tracks in, patches of a round drivable area out
    Localiser,
    /// A source: a detector's detections out
    Source,
    /// An additional stage: forecasts in, a new topic out
    Monitor,
    /// An inserted stage: tracks in, tracks out; the localiser reads its output
    Filter,
    /// A consumer, such as a planner, that reads the forecasts of a run
    Consumer,
}

impl Template {
    /// Returns the source text of the program.
    const fn text(self) -> &'static str {
        match self {
            Self::Localiser => include_str!("../../../../tests/examples/area_localiser.rs"),
            Self::Source => include_str!("../../../../tests/examples/producer.rs"),
            Self::Monitor => include_str!("../../../../tests/examples/conflict_monitor.rs"),
            Self::Filter => include_str!("../../../../tests/examples/speed_limiter.rs"),
            Self::Consumer => include_str!("../../../../tests/examples/consumer.rs"),
        }
    }

    /// Returns the example's name.
    const fn example(self) -> &'static str {
        match self {
            Self::Localiser => "area_localiser",
            Self::Source => "producer",
            Self::Monitor => "conflict_monitor",
            Self::Filter => "speed_limiter",
            Self::Consumer => "consumer",
        }
    }

    /// Returns the stage that the program replaces.
    const fn stage(self) -> Option<&'static str> {
        match self {
            Self::Localiser => Some("localiser"),
            Self::Source => Some("source"),
            Self::Monitor | Self::Filter | Self::Consumer => None,
        }
    }

    /// Whether the program is added to the pipeline as another stage.
    const fn is_added(self) -> bool {
        matches!(self, Self::Monitor | Self::Filter)
    }
}

/// Writes a cargo project.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let Arguments { name, of, dir, repository } = arguments;
    check_name(name)?;
    let folder = absolute(&dir.join(name))?;
    if folder.try_exists().map_err(|error| Failure::file(&folder, error))? {
        return Err(Failure::Usage(format!("{}: is there already", folder.display())));
    }
    let repository = Repository::find(repository.as_deref())?;
    let source = folder.join("src");
    std::fs::create_dir_all(&source).map_err(|error| Failure::file(&source, error))?;
    let write =
        |path: PathBuf, text: &str| std::fs::write(&path, text).map_err(|error| Failure::file(&path, error));
    write(folder.join("Cargo.toml"), &manifest(*of, name, &repository))?;
    write(source.join("main.rs"), &program(*of, name))?;
    if let Some(text) = pipeline(*of, name) {
        write(folder.join("pipeline.toml"), &text)?;
    }
    if let Repository::Folder(root) = &repository {
        for file in PINNED {
            let from = root.join(file);
            std::fs::copy(&from, folder.join(file)).map_err(|error| Failure::file(&from, error))?;
        }
    }
    show(&next_steps(*of, name, &folder))
}

/// The origin of the crates that the project depends on.
#[derive(Debug)]
enum Repository {
    Folder(PathBuf),
    Git(String),
}

impl Repository {
    fn find(given: Option<&str>) -> Result<Self, Failure> {
        if let Some(url) = given.filter(|given| given.contains("://") || given.starts_with("git@")) {
            return Ok(Self::Git(url.to_owned()));
        }
        let root = Path::new(given.unwrap_or(BUILT_FROM));
        if !root.join("shared/ports/Cargo.toml").is_file() {
            let root = root.display();
            return Err(Failure::Usage(format!(
                "{root}: no repository of stgdat; --repository names another folder or the address of one"
            )));
        }
        Ok(Self::Folder(root.canonicalize().map_err(|error| Failure::file(root, error))?))
    }

    /// Returns a dependency on one of the repository's crates.
    fn dependency(&self, name: &str) -> String {
        match self {
            Self::Folder(root) => {
                let path = toml::Value::from(root.join("shared").join(name).display().to_string());
                format!("{name} = {{ package = \"stgdat-{name}\", path = {path} }}\n")
            }
            Self::Git(url) => {
                format!(
                    "{name} = {{ package = \"stgdat-{name}\", git = {} }}\n",
                    toml::Value::from(url.as_str())
                )
            }
        }
    }
}

/// Refuses names that cargo does not accept for a package.
fn check_name(name: &str) -> Result<(), Failure> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(is_plain) {
        return Ok(());
    }
    Err(Failure::Usage(format!("\"{name}\": expected a letter, then letters, digits, \"_\" and \"-\"")))
}

fn manifest(of: Template, name: &str, repository: &Repository) -> String {
    // The source plays recordings.
    let more = (of == Template::Source).then_some("data");
    let ours: String = OURS.into_iter().chain(more).map(|of| repository.dependency(of)).collect();
    format!(
        "[package]\nname = \"{name}\"\nversion = \"0.1.0\"\nedition = \"2024\"\npublish = false\n\n\
         [dependencies]\n{ours}{DEPENDENCIES}\n\
         # A workspace of its own, also within the folder of another.\n[workspace]\n"
    )
}

/// Returns the example with the project's name.
fn program(of: Template, name: &str) -> String {
    let example = of.example();
    let text =
        of.text().replace(&format!("target/release/examples/{example}"), &format!("target/release/{name}"));
    text.replace(&format!("name = \"{example}\""), &format!("name = \"{}\"", name.to_lowercase()))
}

/// Returns the shipped pipeline with the project's program, which replaces a stage or is added as one.
fn pipeline(of: Template, name: &str) -> Option<String> {
    let shipped = pipeline_file::SHIPPED;
    if let Some(stage) = of.stage() {
        let line = format!("name = \"{stage}\"\n");
        return Some(shipped.replacen(&line, &format!("{line}command = [\"target/release/{name}\"]\n"), 1));
    }
    if !of.is_added() {
        return None;
    }
    // The lines are part of the program's text.
    let program = program(of, name);
    let lines = program.lines().skip_while(|line| *line != "//! ```toml").skip(1);
    let lines = lines.map_while(|line| line.strip_prefix("//!")).take_while(|line| line.trim() != "```");
    let lines: Vec<&str> = lines.map(str::trim_start).collect();
    let localiser = "name = \"localiser\"\n";
    let renamed = format!("{localiser}topics = {{ tracks = \"limited-tracks\" }}\n");
    let shipped =
        if of == Template::Filter { shipped.replacen(localiser, &renamed, 1) } else { shipped.to_owned() };
    Some(format!("{shipped}\n{}\n", lines.join("\n")))
}

fn next_steps(of: Template, name: &str, folder: &Path) -> String {
    let folder = folder.display();
    let run = match of.stage() {
        Some(stage) => format!(
            "  stgdat run --pipeline pipeline.toml\n\
             or, while a run is running:\n  stgdat stage replace {stage} --exec target/release/{name}\n"
        ),
        None if of.is_added() => "  stgdat run --pipeline pipeline.toml\n".to_owned(),
        None => format!("  target/release/{name}    # while `stgdat run` is running\n"),
    };
    format!("{folder} is written. Next:\n  cd {folder}\n  cargo build --release\n{run}")
}

#[cfg(test)]
mod tests {
    use toml::Value;

    use super::*;

    #[test]
    fn names_are_those_of_packages() {
        for name in ["mine", "my-stage_2"] {
            assert!(check_name(name).is_ok(), "{name}");
        }
        for name in ["", "2nd", "a b", "../a", "ä"] {
            assert!(check_name(name).is_err(), "{name}");
        }
    }

    #[test]
    fn the_pipeline_of_a_project_starts_its_program() {
        for of in Template::value_variants() {
            let Some(text) = pipeline(*of, "mine") else { continue };
            let pipeline =
                configuration::Pipeline::parse("a.toml", &text, &configuration::stages::declared()).unwrap();
            let own: Vec<_> = pipeline.stages.iter().filter_map(|stage| stage.command.clone()).collect();
            assert_eq!(own, [["target/release/mine"]]);
            let added = pipeline.stages.iter().find(|stage| stage.id.is_added());
            assert_eq!(added.map(|stage| stage.name.as_str()), of.is_added().then_some("mine"));
        }
    }

    #[test]
    fn a_project_depends_on_a_folder_or_an_address() {
        let of = Template::Localiser;
        let folder = manifest(of, "mine", &Repository::find(None).unwrap());
        let git = manifest(of, "mine", &Repository::find(Some("https://example.org/stgdat.git")).unwrap());
        for (text, key) in [(&folder, "path"), (&git, "git")] {
            let table: toml::Table = text.parse().unwrap();
            assert!(OURS.iter().all(|name| table["dependencies"][*name][key].is_str()), "{text}");
        }
        assert!(Repository::find(Some("/nowhere")).is_err());
    }

    /// The workspace compiles the programs as its examples. In addition, a project needs the right
    /// dependencies.
    #[test]
    fn a_project_has_the_dependencies_of_its_program() {
        let parsed = |text: &str| text.parse::<toml::Table>().unwrap();
        let workspace = parsed(include_str!("../../../../Cargo.toml"));
        for of in Template::value_variants() {
            let manifest = parsed(&manifest(*of, "mine", &Repository::find(None).unwrap()));
            let dependencies = manifest["dependencies"].as_table().unwrap();
            let source = program(*of, "mine");
            let uses = source.lines().filter_map(|line| line.strip_prefix("use ")?.split("::").next());
            for name in uses.filter(|name| *name != "std") {
                assert!(dependencies.contains_key(name), "{of:?} uses {name}");
            }
            for (name, own) in dependencies.iter().filter(|(_, own)| own.get("version").is_some()) {
                let ours = &workspace["workspace"]["dependencies"][name];
                assert_eq!(own["features"], ours["features"], "{name}");
                let version = |value: &Value| value["version"].as_str().unwrap().to_owned();
                assert!(version(ours).starts_with(&version(own)), "{name}: the lock has another version");
            }
        }
    }
}
