//! The map in docs/architecture.md against the manifests of the workspace, and the order of the crates' modules.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// The stages that a vehicle runs.
const ONLINE: [&str; 8] =
    ["source", "tracker", "localiser", "extractor", "encoder", "decoder", "sampler", "recorder"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the repository")
}

/// The name of a crate in the code: without the prefix of this project's packages.
fn short(package: &Value) -> String {
    let name = package["name"].as_str().expect("a name");
    name.strip_prefix("stgdat-").unwrap_or(name).replace('-', "_")
}

/// The packages of the workspace.
fn packages() -> Vec<Value> {
    let metadata = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(root())
        .output()
        .expect("cargo runs");
    assert!(metadata.status.success(), "{}", String::from_utf8_lossy(&metadata.stderr));
    let metadata: Value = serde_json::from_slice(&metadata.stdout).expect("JSON");
    list(&metadata["packages"])
}

fn list(of: &Value) -> Vec<Value> {
    of.as_array().cloned().unwrap_or_default()
}

/// The crates that each crate of the workspace depends on, outside tests.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let used = |package: &Value| {
        let normal = list(&package["dependencies"]).into_iter().filter(|one| one["kind"].is_null());
        normal.map(|one| short(&one)).collect()
    };
    packages().iter().map(|package| (short(package), used(package))).collect()
}

/// The crates in a folder of the repository.
fn crates_in(folder: &str) -> BTreeSet<String> {
    let is_in = |package: &&Value| {
        let manifest = package["manifest_path"].as_str().expect("a path");
        Path::new(manifest).starts_with(root().join(folder))
    };
    packages().iter().filter(is_in).map(short).collect()
}

/// The words in backticks.
fn names(cell: &str) -> BTreeSet<String> {
    cell.split('`').skip(1).step_by(2).map(ToOwned::to_owned).collect()
}

#[test]
fn the_map_names_the_dependencies_of_each_crate_from_the_leaves_up() {
    let dependencies = dependencies();
    let page = std::fs::read_to_string(root().join("docs/architecture.md")).expect("the page");
    for folder in ["shared", "launch"] {
        let (crates, mut above) = (crates_in(folder), BTreeSet::new());
        for line in page.lines() {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let ["", name, _, knows, ""] = cells.as_slice() else { continue };
            let Some(name) = crates.get(name.trim_matches('`')) else { continue };
            let own: BTreeSet<String> = dependencies[name].intersection(&crates).cloned().collect();
            assert_eq!(names(knows), own, "{line}");
            assert!(own.is_subset(&above), "not from the leaves up: {line}");
            above.insert(name.clone());
        }
        assert_eq!(above, crates);
    }
}

#[test]
fn no_library_depends_on_a_stage_or_a_program() {
    let (dependencies, libraries) = (dependencies(), crates_in("shared"));
    for library in &libraries {
        let others = dependencies[library].iter().filter(|one| dependencies.contains_key(*one));
        assert!(others.clone().all(|one| libraries.contains(one)), "{library}: {:?}", dependencies[library]);
    }
}

#[test]
fn iceoryx2_and_bincode_have_the_users_that_the_page_names() {
    let dependencies = dependencies();
    let users = |used: &str| -> Vec<&String> {
        dependencies.iter().filter(|(_, all)| all.contains(used)).map(|(name, _)| name).collect()
    };
    assert_eq!(users("iceoryx2"), ["ports"]);
    assert_eq!(users("bincode"), ["evaluator", "run"]);
}

#[test]
fn no_online_stage_depends_on_another() {
    let dependencies = dependencies();
    for stage in ONLINE {
        let others: Vec<&String> =
            dependencies[stage].iter().filter(|name| ONLINE.contains(&name.as_str())).collect();
        assert!(others.is_empty(), "{stage}: {others:?}");
    }
}

/// The crates whose modules import only from the lines below their own, in the table of `lib.rs`.
const LAYERED: [&str; 6] = ["configuration", "console", "evaluator", "faults", "supervisor", "telemetry"];

#[test]
fn no_module_imports_from_its_own_line_or_above() {
    let packages = packages();
    for name in LAYERED {
        let package = packages.iter().find(|package| short(package) == name).expect("a crate");
        let manifest = Path::new(package["manifest_path"].as_str().expect("a path"));
        assert_layers(&manifest.with_file_name("src"));
    }
}

/// Asserts that each module of a crate imports only from the lines below its own, in the table of `lib.rs`.
fn assert_layers(source: &Path) {
    let landing_page = std::fs::read_to_string(source.join("lib.rs")).expect("a library");
    let table = landing_page.split("```").nth(1).expect("lib.rs has a block of code");
    let line_of = |module: &str| {
        let names =
            |line: &str| line.trim_start_matches("//! ").split("  ").any(|word| word.trim() == module);
        let line = table.lines().skip(1).position(names);
        line.unwrap_or_else(|| panic!("{module} is not in the table of {}", source.display()))
    };
    for path in files(source) {
        let own = path.strip_prefix(source).expect("a file of the crate").with_extension("");
        let own = own.iter().next().and_then(|name| name.to_str()).expect("a module");
        if own == "lib" {
            continue;
        }
        let text = std::fs::read_to_string(&path).expect("a source file");
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        for used in text.split("use crate::").skip(1) {
            let used = used.split(';').next().unwrap_or_default();
            // Either one path, or several in braces.
            let paths = used.strip_prefix('{').map_or(vec![used], |several| several.split(',').collect());
            for path in paths {
                let used = path.split([':', '}']).next().unwrap_or_default().trim();
                assert!(own == used || line_of(used) > line_of(own), "{own} imports from {used}");
            }
        }
    }
}

/// The sources in a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}
