//! Result tables in Markdown files. A verb writes its table between two marks, so the measured values are
//! part of the page.

use std::fmt::Display;
use std::path::Path;

use crate::failure::Failure;

/// The head of a table. Values of a column whose name ends in `:` are aligned right.
pub fn head(columns: &[impl AsRef<str>]) -> String {
    let columns = || columns.iter().map(AsRef::as_ref);
    let names = row(columns().map(|column| column.trim_end_matches(':')));
    let rule: String = columns().map(|column| if column.ends_with(':') { "---:|" } else { "---|" }).collect();
    format!("{names}|{rule}\n")
}

/// A row of a table.
pub fn row(cells: impl IntoIterator<Item = impl Display>) -> String {
    cells.into_iter().fold("|".to_owned(), |row, cell| row + &format!(" {cell} |")) + "\n"
}

/// Replaces the text between the marks `stgdat NAME` of a Markdown file by `table`.
///
/// # Errors
/// [`Failure::Data`] names the file if it can't be read or written or lacks the marks.
pub fn replace(path: &Path, name: &str, table: &str) -> Result<(), Failure> {
    let file = |error: std::io::Error| Failure::file(path, error);
    let old = std::fs::read_to_string(path).map_err(file)?;
    let (begin, end) = (format!("<!-- begin stgdat {name} -->"), format!("<!-- end stgdat {name} -->"));
    let parts = old.split_once(&begin).and_then(|(head, rest)| Some((head, rest.split_once(&end)?.1)));
    let Some((head, tail)) = parts else {
        let path = path.display();
        return Err(Failure::data(format!("{path}: no place for the table: add the lines\n{begin}\n{end}")));
    };
    std::fs::write(path, format!("{head}{begin}\n{}\n{end}{tail}", table.trim_end())).map_err(file)
}

/// Replaces or adds the section with this heading between the marks `stgdat NAME`. Sections of other machines
/// stay.
///
/// # Errors
/// As [`replace`].
pub fn replace_section(path: &Path, name: &str, heading: &str, text: &str) -> Result<(), Failure> {
    let old = std::fs::read_to_string(path).map_err(|error| Failure::file(path, error))?;
    let [begin, end] = ["begin", "end"].map(|end| format!("<!-- {end} stgdat {name} -->"));
    let between = old.split_once(&begin).and_then(|(_, rest)| rest.split_once(&end));
    replace(path, name, &with_section(between.map_or("", |(between, _)| between), heading, text))
}

/// Returns the text with the section of `heading` replaced, or appended. A section begins with `### HEADING`.
fn with_section(old: &str, heading: &str, text: &str) -> String {
    let new = format!("### {heading}\n\n{}\n", text.trim());
    let mut sections: Vec<String> = Vec::new();
    for line in old.trim().lines() {
        match sections.last_mut() {
            Some(last) if !line.starts_with("### ") => *last += &format!("{line}\n"),
            _ => sections.push(format!("{line}\n")),
        }
    }
    let first_line = format!("### {heading}\n");
    match sections.iter_mut().find(|section| section.starts_with(&first_line)) {
        Some(section) => *section = new,
        None => sections.push(new),
    }
    let sections: Vec<&str> =
        sections.iter().map(|section| section.trim()).filter(|s| !s.is_empty()).collect();
    sections.join("\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_its_figures_on_the_right() {
        let text = head(&["stage", "p50 ms:"]) + &row(["encoder", "1.50"]) + &row([2, 3]);
        assert_eq!(text, "| stage | p50 ms |\n|---|---:|\n| encoder | 1.50 |\n| 2 | 3 |\n");
    }

    const MARKS: [&str; 2] = ["<!-- begin stgdat x -->", "<!-- end stgdat x -->"];

    /// A file of this process only, removed at the end.
    struct Page(std::path::PathBuf);

    impl Page {
        fn new(name: &str, text: &str) -> Self {
            let name = format!("stgdat_tables_{name}_{}.md", std::process::id());
            let path = std::env::temp_dir().join(name);
            std::fs::write(&path, text).unwrap();
            Self(path)
        }
    }

    impl Drop for Page {
        fn drop(&mut self) {
            let _ = std::fs::remove_file(&self.0);
        }
    }

    #[test]
    fn a_table_replaces_what_stood_between_its_marks() {
        let [begin, end] = MARKS;
        let page = Page::new("replace", &format!("a\n{begin}\nold\n{end}\nb\n"));
        replace(&page.0, "x", "new\n").unwrap();
        assert_eq!(std::fs::read_to_string(&page.0).unwrap(), format!("a\n{begin}\nnew\n{end}\nb\n"));
    }

    #[test]
    fn a_machine_replaces_its_own_section_alone() {
        let one = with_section("", "A, 2 cores", "| 1 |\n");
        assert_eq!(one, "### A, 2 cores\n\n| 1 |");
        let two = with_section(&one, "B, 4 cores", "| 2 |\n\nmore\n");
        assert_eq!(two, "### A, 2 cores\n\n| 1 |\n\n### B, 4 cores\n\n| 2 |\n\nmore");
        let again = with_section(&two, "A, 2 cores", "| 3 |");
        assert_eq!(again, "### A, 2 cores\n\n| 3 |\n\n### B, 4 cores\n\n| 2 |\n\nmore");
        let [begin, end] = MARKS;
        let page = Page::new("section", &format!("a\n{begin}\n{two}\n{end}\nb\n"));
        replace_section(&page.0, "x", "B, 4 cores", "new").unwrap();
        let written = std::fs::read_to_string(&page.0).unwrap();
        assert_eq!(written, format!("a\n{begin}\n{one}\n\n### B, 4 cores\n\nnew\n{end}\nb\n"));
    }

    #[test]
    fn without_marks_the_error_contains_the_lines_to_add() {
        let page = Page::new("marks", "a\n");
        let refused = replace(&page.0, "x", "new\n").unwrap_err().to_string();
        let path = page.0.display();
        assert_eq!(refused, format!("{path}: no place for the table: add the lines\n{}", MARKS.join("\n")));
        assert_eq!(std::fs::read_to_string(&page.0).unwrap(), "a\n");
    }

    #[test]
    fn a_missing_file_is_an_error_that_names_it() {
        let refused = replace(Path::new("no/such/page.md"), "x", "new\n").unwrap_err();
        assert_eq!(refused.exit(), run::Exit::Data);
        assert!(refused.to_string().starts_with("no/such/page.md: "), "{refused}");
    }
}
