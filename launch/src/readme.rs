use std::path::Path;

use crate::failure::Failure;

/// Puts `text` between the marks `stgdat NAME` of a Markdown file, so that a verb keeps its table up to date.
pub fn insert(path: &Path, name: &str, text: &str) -> Result<(), Failure> {
    let file = |error: std::io::Error| Failure::file(path, &error);
    let old = std::fs::read_to_string(path).map_err(file)?;
    let (begin, end) = (format!("<!-- begin stgdat {name} -->"), format!("<!-- end stgdat {name} -->"));
    let parts = old.split_once(&begin).and_then(|(head, rest)| Some((head, rest.split_once(&end)?.1)));
    let Some((head, tail)) = parts else {
        return Err(Failure::Data(format!("{}: no lines `{begin}` and `{end}`", path.display())));
    };
    std::fs::write(path, format!("{head}{begin}\n{}\n{end}{tail}", text.trim_end())).map_err(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_replaces_what_stood_between_the_marks() {
        let path = std::env::temp_dir().join(format!("stgdat_readme_{}.md", std::process::id()));
        let (begin, end) = ("<!-- begin stgdat x -->", "<!-- end stgdat x -->");
        std::fs::write(&path, format!("a\n{begin}\nold\n{end}\nb\n")).unwrap();
        insert(&path, "x", "new\n").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("a\n{begin}\nnew\n{end}\nb\n"));
        assert!(insert(&path, "y", "new").is_err());
        std::fs::remove_file(&path).unwrap();
    }
}
