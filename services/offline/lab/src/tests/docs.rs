//! Tests of the documentation: links and anchors resolve, command lines parse, and the book's summary lists
//! every page.

mod commands;
mod links;

use std::path::{Path, PathBuf};

/// The repository's root.
fn root() -> PathBuf {
    let lab = Path::new(env!("CARGO_MANIFEST_DIR"));
    lab.ancestors().nth(3).expect("the laboratory lies in services/offline").to_owned()
}

/// A page of Markdown.
struct Page {
    /// Path relative to the root, for messages.
    name: String,
    path: PathBuf,
    text: String,
}

impl Page {
    fn read(path: PathBuf) -> Self {
        let name = path.strip_prefix(root()).unwrap_or(&path).display().to_string();
        let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        Self { name, path, text }
    }

    /// The lines with their numbers, starting at 1. A line in a code block comes with the block's language.
    fn lines(&self) -> Vec<(usize, Option<String>, &str)> {
        let mut fence: Option<(String, String)> = None;
        let mut lines = Vec::new();
        for (line, number) in self.text.lines().zip(1..) {
            let trimmed = line.trim_start();
            let marks: String = trimmed.chars().take_while(|&c| c == '`' || c == '~').collect();
            match &fence {
                Some((opened, _)) if marks.starts_with(opened.as_str()) && trimmed.trim_end() == marks => {
                    fence = None;
                }
                Some((_, language)) => lines.push((number, Some(language.clone()), line)),
                None if marks.len() >= 3 => {
                    let language = trimmed[marks.len()..].split([' ', ',', '{']).next().unwrap_or_default();
                    fence = Some((marks, language.to_owned()));
                }
                None => lines.push((number, None, line)),
            }
        }
        lines
    }
}

/// All files below a folder with this ending.
fn below(folder: &Path, end: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let of_path = |path: PathBuf| match path.is_dir() {
        true => below(&path, end),
        false if path.to_string_lossy().ends_with(end) => vec![path],
        false => Vec::new(),
    };
    paths.into_iter().flat_map(of_path).collect()
}

/// The pages that are tested.
fn pages() -> Vec<Page> {
    let root = root();
    let mut paths: Vec<PathBuf> =
        ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(|name| root.join(name)).into();
    paths.extend(below(&root.join("docs"), ".md"));
    paths.extend(below(&root.join("tests/golden"), "README.md"));
    paths.into_iter().map(Page::read).collect()
}

#[test]
fn every_link_resolves() {
    let broken: Vec<String> = pages().iter().flat_map(links::broken).collect();
    assert!(broken.is_empty(), "{} broken links:\n{}", broken.len(), broken.join("\n"));
}

#[test]
fn every_command_line_parses() {
    let (mut refused, mut command_count) = (Vec::new(), 0);
    for page in pages() {
        for (number, command) in commands::of_page(&page) {
            command_count += 1;
            if let Err(error) = commands::parse(&command) {
                let reason = error.lines().next().unwrap_or_default();
                refused.push(format!("{}:{number}: {}\n    {reason}", page.name, command.join(" ")));
            }
        }
    }
    assert!(refused.is_empty(), "{} of {command_count} refused:\n{}", refused.len(), refused.join("\n"));
}

#[test]
fn every_page_of_docs_is_in_the_summary() {
    let docs = root().join("docs");
    let summary = Page::read(docs.join("SUMMARY.md"));
    let listed: Vec<PathBuf> =
        links::of_page(&summary).into_iter().map(|(_, link)| docs.join(link)).collect();
    let is_missing = |path: &PathBuf| *path != summary.path && !listed.contains(path);
    let missing: Vec<PathBuf> = below(&docs, ".md").into_iter().filter(is_missing).collect();
    assert!(missing.is_empty(), "not in docs/SUMMARY.md: {missing:#?}");
}

/// Whether the comments of a source file contain an example that `cargo test` runs.
fn has_example(source: &str) -> bool {
    let mut is_open = false;
    source.lines().any(|line| {
        let line = line.trim_start();
        let comment = line.strip_prefix("///").or_else(|| line.strip_prefix("//!"));
        let Some(language) = comment.and_then(|text| text.trim_start().strip_prefix("```")) else {
            return false;
        };
        is_open = !is_open;
        is_open && matches!(language.trim(), "" | "rust" | "no_run" | "should_panic" | "compile_fail")
    })
}

/// Crates without tests or examples build no test program.
#[test]
fn no_manifest_leaves_out_tests_or_examples() {
    let manifests =
        ["launch", "services", "shared", "tests"].map(|folder| below(&root().join(folder), "Cargo.toml"));
    for manifest in manifests.into_iter().flatten() {
        let read = |path: &PathBuf| std::fs::read_to_string(path).expect("the file can be read");
        let text = read(&manifest);
        let library =
            text.split("[lib]").nth(1).and_then(|rest| rest.split("\n\n").next()).unwrap_or_default();
        let has = |key: &str| library.lines().any(|line| line == key);
        let folder = manifest.parent().expect("a manifest is in a folder").join("src");
        for source in below(&folder, ".rs").iter().map(read) {
            assert!(!(has("test = false") && source.contains("#[test]")), "{}", manifest.display());
            assert!(!(has("doctest = false") && has_example(&source)), "{}", manifest.display());
        }
    }
}
