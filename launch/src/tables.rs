//! Result tables in Markdown files: a verb writes its table between two marks, so that a page keeps what was
//! measured.

use std::path::Path;

use crate::failure::Failure;

/// Replaces what stands between the marks `stgdat NAME` of a Markdown file by `table`.
///
/// # Errors
/// [`Failure::Data`] with the file's name where it can't be read or written, or lacks the marks.
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

#[cfg(test)]
mod tests {
    use super::*;

    const MARKS: [&str; 2] = ["<!-- begin stgdat x -->", "<!-- end stgdat x -->"];

    /// A file of this process alone, removed in the end.
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
