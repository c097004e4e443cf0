//! Prints that bypass the function that escapes control characters.

use std::fs;
use std::path::{Path, PathBuf};

/// What writes to a terminal. A line that calls `escaped` is no bypass.
const PRINTS: [&str; 10] = [
    "println!",
    "print!(",
    "eprintln!",
    "eprint!(",
    "dbg!(",
    "stdout().lock()",
    "stderr().lock()",
    "stderr().write",
    "(std::io::stderr(),",
    "(std::io::stdout(),",
];

/// Files that may, with the reason.
const PERMITTED: [(&str, &str); 5] = [
    ("launch/console/src/show.rs", "escapes the text before"),
    ("launch/console/src/streams.rs", "its callers escape"),
    ("launch/faults/src/follow.rs", "writes JSON, whose encoder escapes"),
    ("services/bridge/src/main.rs", "writes JSON, whose encoder escapes"),
    ("services/foxglove/src/live.rs", "escapes the text before"),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder").flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        if path.is_dir() {
            if !["tests", "benches", "examples", "target"].iter().any(|other| name == *other) {
                sources(&path, found);
            }
        } else if name.to_string_lossy().ends_with(".rs") && name != "tests.rs" && name != "build.rs" {
            found.push(path);
        }
    }
}

#[test]
fn no_print_bypasses_the_function_that_escapes_names() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    let mut files = Vec::new();
    for folder in ["shared", "services", "launch"] {
        sources(&root.join(folder), &mut files);
    }
    assert!(files.len() > 200, "{} files", files.len());
    let mut bypasses = Vec::new();
    for path in files {
        let name = path.strip_prefix(root).expect("in the workspace").to_string_lossy().into_owned();
        let text = fs::read_to_string(&path).expect("a source");
        // Tests print for developers.
        let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
        let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        let is_bypass =
            |line: &&str| PRINTS.iter().any(|print| line.contains(print)) && !line.contains("escaped(");
        let prints: Vec<&str> = lines.filter(is_bypass).collect();
        match PERMITTED.iter().any(|(permitted, _)| *permitted == name) {
            true => assert!(!prints.is_empty(), "{name} needs no permission"),
            false => bypasses.extend(prints.iter().map(|line| format!("{name}: {}", line.trim()))),
        }
    }
    assert!(bypasses.is_empty(), "use `say!`, `show` or `tracing`: {bypasses:#?}");
}
