//! The order of a crate's modules.

use std::path::{Path, PathBuf};

/// Asserts that each module of a crate imports only from the lines below its own, in the first block of code of
/// `lib.rs`.
///
/// # Panics
/// If an import goes backwards, or a module is missing in the block.
pub fn assert_layers(crate_folder: &str) {
    let source = Path::new(crate_folder).join("src");
    let landing_page = std::fs::read_to_string(source.join("lib.rs")).unwrap();
    let table = landing_page.split("```").nth(1).expect("lib.rs has a block of code");
    let line_of = |module: &str| {
        let names =
            |line: &str| line.trim_start_matches("//! ").split("  ").any(|word| word.trim() == module);
        let line = table.lines().skip(1).position(names);
        line.unwrap_or_else(|| panic!("{module} is not in the table of lib.rs"))
    };
    for path in files(&source) {
        let own = path.strip_prefix(&source).unwrap().with_extension("");
        let own = own.iter().next().and_then(|name| name.to_str()).unwrap();
        if own == "lib" {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
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
    let paths = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}
