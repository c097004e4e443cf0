//! The links of a page and their targets.

use std::collections::BTreeMap;

use super::Page;

/// Links outside of code, with their line numbers.
pub fn of_page(page: &Page) -> Vec<(usize, String)> {
    let prose = page.lines().into_iter().filter(|(_, language, _)| language.is_none());
    prose.flat_map(|(number, _, line)| of_line(line).into_iter().map(move |link| (number, link))).collect()
}

/// Targets of `[text](target)`, `[name]: target`, `href="target"` and `src="target"`.
fn of_line(line: &str) -> Vec<String> {
    let line = without_code(line);
    let mut links = Vec::new();
    for (start, _) in line.match_indices("](") {
        let target = target(&line[start + 2..], ')');
        links.extend(target.split_whitespace().next().map(|link| link.trim_matches(['<', '>']).to_owned()));
    }
    if let Some((name, link)) = line.trim_start().split_once("]:")
        && name.starts_with('[')
        && !name.starts_with("[^")
    {
        links.extend(link.split_whitespace().next().map(ToOwned::to_owned));
    }
    for attribute in ["href=\"", "src=\""] {
        let starts = line.match_indices(attribute);
        links.extend(starts.map(|(start, _)| target(&line[start + attribute.len()..], '"').to_owned()));
    }
    links
}

/// The text up to `end`, which may contain pairs of brackets.
fn target(text: &str, end: char) -> &str {
    let mut depth = 0;
    for (place, c) in text.char_indices() {
        if c == end && depth == 0 {
            return &text[..place];
        }
        depth += i32::from(c == '(') - i32::from(c == ')');
    }
    text
}

/// The line without its code in backticks.
fn without_code(line: &str) -> String {
    let parts: Vec<&str> = line.split('`').collect();
    // With an odd number of backticks, the last one does not start code.
    let closed = if parts.len() % 2 == 1 { parts.len() } else { parts.len() - 1 };
    let is_prose = |(place, _): &(usize, &&str)| place % 2 == 0 || *place >= closed;
    parts.iter().enumerate().filter(is_prose).map(|(_, part)| *part).collect()
}

/// One message per broken link.
pub fn broken(page: &Page) -> Vec<String> {
    let links = of_page(page).into_iter();
    links
        .filter_map(|(number, link)| Some(format!("{}:{number}: {link}: {}", page.name, fault(page, &link)?)))
        .collect()
}

/// The defect of a link, if any; links out of the repository are not checked.
fn fault(page: &Page, link: &str) -> Option<String> {
    if link.contains("://") || link.starts_with("mailto:") {
        return None;
    }
    let (file, anchor) = link.split_once('#').map_or((link, None), |(file, anchor)| (file, Some(anchor)));
    let path = match file {
        "" => page.path.clone(),
        _ => page.path.parent()?.join(file.replace("%20", " ")),
    };
    if !path.exists() {
        return Some("no such file".to_owned());
    }
    let anchor = anchor.filter(|_| path.extension().is_some_and(|extension| extension == "md"))?;
    let anchors = anchors(&Page::read(path));
    (!anchors.iter().any(|known| known == anchor)).then(|| "no such heading".to_owned())
}

/// The anchors of a page: headings as GitHub and mdBook name them, and `id="…"` and `name="…"`.
fn anchors(page: &Page) -> Vec<String> {
    let (mut anchors, mut seen) = (Vec::new(), BTreeMap::<String, usize>::new());
    for (_, _, line) in page.lines().into_iter().filter(|(_, language, _)| language.is_none()) {
        let level = line.chars().take_while(|&c| c == '#').count();
        if (1..=6).contains(&level) && line[level..].starts_with(' ') {
            let slug = slug(&line[level + 1..]);
            let count = seen.entry(slug.clone()).or_default();
            anchors.push(if *count == 0 { slug } else { format!("{slug}-{count}") });
            *count += 1;
        }
        for attribute in ["id=\"", "name=\""] {
            let starts = line.match_indices(attribute);
            anchors.extend(starts.map(|(start, _)| target(&line[start + attribute.len()..], '"').to_owned()));
        }
    }
    anchors
}

/// A heading's anchor: lower case, hyphens for blanks; only letters, digits, `_` and `-` remain.
fn slug(heading: &str) -> String {
    // Only the text of a link counts.
    let mut text = String::new();
    let mut rest = heading.trim().trim_end_matches('#').trim_end();
    while let Some((before, after)) = rest.split_once("](") {
        text += before;
        rest = after.split_once(')').map_or("", |(_, after)| after);
    }
    text += rest;
    let kept = text.to_lowercase().replace(' ', "-");
    kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_')).collect()
}

#[test]
fn links_are_found_in_prose_alone() {
    let line = "see [a](x.md#b \"title\"), `[c](no.md)` and ![d](p_(1).png) <a href=\"y.md\">";
    assert_eq!(of_line(line), ["x.md#b", "p_(1).png", "y.md"]);
    assert_eq!(of_line("[name]: docs/z.md"), ["docs/z.md"]);
    assert!(of_line("[^1]: a footnote").is_empty());
}

#[test]
fn slugs_are_those_of_the_renderers() {
    assert_eq!(slug("minADE₂₀, top-1 & `run --set`"), "minade₂₀-top-1--run---set");
    assert_eq!(slug("A [link](x.md) here"), "a-link-here");
}
