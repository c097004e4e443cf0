//! Converts names and doc comments of the table to the style of other languages.

/// Maximum line length of a comment, in characters.
const LINE_MAX: usize = 110;

/// Appends a line.
pub fn line(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

/// Returns a doc comment as one line of plain text, without links and escapes, and with dots in paths.
pub fn plain(doc: &str) -> String {
    let mut text = doc.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
    // Of [`name`](path), only the name is kept.
    while let Some(begin) = text.find("](") {
        let end = text[begin..].find(')').map_or(text.len(), |end| begin + end + 1);
        text.replace_range(begin..end, "]");
    }
    for (of_rust, plain) in
        [("[`crate::", "[`"), ("[`", "`"), ("`]", "`"), ("\\[", "["), ("\\]", "]"), ("::", ".")]
    {
        text = text.replace(of_rust, plain);
    }
    text
}

/// The first sentence of a doc comment.
pub fn summary(doc: &str) -> String {
    let text = plain(doc);
    match text.split_once(". ") {
        Some((first, _)) => format!("{first}."),
        None => text,
    }
}

/// Wraps text into lines of at most [`LINE_MAX`] characters.
pub fn wrapped(text: &str) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let line = lines.last_mut().expect("there is a first line");
        if line.is_empty() {
            line.push_str(word);
        } else if line.chars().count() + 1 + word.chars().count() <= LINE_MAX {
            line.push(' ');
            line.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines
}

/// Converts `AgentType` to `agent_type`. Names with spaces work too.
pub fn snake(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.push(if letter == ' ' { '_' } else { letter.to_ascii_lowercase() });
    }
    text
}

/// Converts `time of receipt` to `TIME_OF_RECEIPT`, and `AgentType` to `AGENT_TYPE`.
pub fn capitals(name: &str) -> String {
    snake(name).to_uppercase()
}

/// Converts `detection_flags` to `DetectionFlags`.
pub fn camel(name: &str) -> String {
    let part = |part: &str| {
        let (first, rest) = part.split_at(1);
        first.to_uppercase() + rest
    };
    name.split('_').map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doc_comments_become_plain_sentences() {
        let doc = " See [`Header::ego_m`](super::Header::ego_m) and\n [`crate::Track`] as \\[x, y\\]. More.\n\n Yet more.\n";
        assert_eq!(plain(doc), "See `Header.ego_m` and `Track` as [x, y]. More. Yet more.");
        assert_eq!(summary(doc), "See `Header.ego_m` and `Track` as [x, y].");
        assert_eq!(summary(" Zero.\n"), "Zero.");
    }

    #[test]
    fn long_texts_break_between_words() {
        let words = "twelve chars".to_owned() + &" word".repeat(30);
        let lines = wrapped(&words);
        assert_eq!((lines.len(), lines.join(" ")), (2, words));
        assert!(lines.iter().all(|line| line.len() <= LINE_MAX));
        assert_eq!(wrapped("one"), ["one"]);
    }

    #[test]
    fn names_take_the_manner_of_the_language() {
        assert_eq!(snake("AgentControls"), "agent_controls");
        assert_eq!(capitals("time of receipt"), "TIME_OF_RECEIPT");
        assert_eq!(camel("detection_flags"), "DetectionFlags");
    }
}
