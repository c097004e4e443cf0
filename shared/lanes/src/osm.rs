//! OSM XML: nodes, ways and relations by number, with their tags.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use roxmltree::{Document, Node as XmlNode, ParsingOptions};

use crate::skipped::{Skipped, SkippedKind};
use crate::{Element, Kind, LaneMapError};

/// Size of the largest accepted file. In memory it takes several times as much.
pub const XML_BYTES_MAX: u64 = 256 << 20;
/// Maximum number of elements, texts and comments in a file.
const XML_NODES_MAX: u32 = 16_000_000;
/// Maximum number of attributes of an element. The parser compares each attribute with all others of its element.
const ATTRIBUTES_MAX: usize = 256;
/// Maximum number of nodes of a bound and of members of a lanelet.
pub const MEMBERS_MAX: usize = 10_000;

/// The tags of an element. If a key occurs twice, the first tag counts.
#[derive(Clone, Copy)]
pub(crate) struct Tags<'a>(pub(crate) XmlNode<'a, 'a>);

/// A member of a relation.
pub(crate) struct Member<'a> {
    pub(crate) element: Element,
    pub(crate) role: &'a str,
}

/// The elements of a file by number, without elements that the file marks as deleted.
///
/// Elements stay XML until a lane needs them. A map has much content that lanes do not need, and faults in
/// that content do not matter.
pub(crate) struct Elements<'a> {
    pub(crate) source: Source<'a>,
    pub(crate) nodes: BTreeMap<i64, XmlNode<'a, 'a>>,
    pub(crate) ways: BTreeMap<i64, XmlNode<'a, 'a>>,
    pub(crate) relations: BTreeMap<i64, XmlNode<'a, 'a>>,
    /// Numbers that occur twice. If no lane needs them, the first element counts.
    twice: BTreeSet<Element>,
}

/// The file, for errors.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) path: &'a str,
    document: &'a Document<'a>,
}

impl Source<'_> {
    /// The line of an XML element, from 1.
    fn line(&self, node: XmlNode<'_, '_>) -> u32 {
        self.document.text_pos_at(node.range().start).row
    }

    pub(crate) fn error(&self, node: XmlNode<'_, '_>, element: Element, problem: String) -> LaneMapError {
        LaneMapError::Element { path: self.path.to_owned(), line: self.line(node), element, problem }
    }
}

impl<'a> Tags<'a> {
    pub(crate) fn get(self, key: &str) -> Option<&'a str> {
        self.iter().find(|(own, _)| *own == key).map(|(_, value)| value)
    }

    /// Whether a tag has the value `yes`; `None` if there is no such tag.
    pub(crate) fn yes(self, key: &str) -> Result<Option<bool>, String> {
        match self.get(key) {
            None => Ok(None),
            Some("yes" | "true" | "1") => Ok(Some(true)),
            Some("no" | "false" | "0") => Ok(Some(false)),
            Some(other) => Err(format!("{key} = \"{}\": expected yes or no", shortened(other))),
        }
    }

    /// All keys with their values.
    pub(crate) fn iter(self) -> impl Iterator<Item = (&'a str, &'a str)> {
        let tags = self.0.children().filter(|child| child.has_tag_name("tag"));
        tags.filter_map(|tag| Some((tag.attribute("k")?, tag.attribute("v")?)))
    }
}

/// Parses the text of a file.
pub(crate) fn parse<'a>(path: &str, text: &'a str) -> Result<Document<'a>, LaneMapError> {
    if let Some(line) = crowded_line(text) {
        let problem = format!("an element has more than {ATTRIBUTES_MAX} attributes");
        return Err(LaneMapError::Syntax { path: path.to_owned(), line, column: 1, problem });
    }
    let options = ParsingOptions { nodes_limit: XML_NODES_MAX, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| LaneMapError::Syntax {
        path: path.to_owned(),
        line: error.pos().row,
        column: error.pos().col,
        problem: format!("not XML: {error}"),
    })?;
    let root = document.root_element();
    if root.tag_name().name() != "osm" {
        let at = document.text_pos_at(root.range().start);
        let problem = format!("the root is `{}`, expected `osm`", shortened(root.tag_name().name()));
        return Err(LaneMapError::Syntax { path: path.to_owned(), line: at.row, column: at.col, problem });
    }
    Ok(document)
}

/// The line of the first tag with more than [`ATTRIBUTES_MAX`] attributes. Text between tags and in quotes does not
/// count; comments count as tags.
fn crowded_line(text: &str) -> Option<u32> {
    let (mut quote, mut attributes, mut line) = (None, None, 1);
    for byte in text.bytes() {
        line += u32::from(byte == b'\n');
        match (byte, quote, &mut attributes) {
            (b'<', None, None) => attributes = Some(0),
            (b'>', None, _) => attributes = None,
            (b'"' | b'\'', None, Some(_)) => quote = Some(byte),
            (_, Some(open), _) if byte == open => quote = None,
            (b'=', None, Some(count)) => {
                *count += 1;
                if *count > ATTRIBUTES_MAX {
                    return Some(line);
                }
            }
            _ => {}
        }
    }
    None
}

impl<'a> Elements<'a> {
    /// The elements of a document. Elements without a number are counted in `skipped`, because nothing can
    /// refer to them.
    pub(crate) fn of(path: &'a str, document: &'a Document<'a>, skipped: &mut Skipped) -> Self {
        let source = Source { path, document };
        let (nodes, ways, relations) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let mut elements = Self { source, nodes, ways, relations, twice: BTreeSet::new() };
        for node in document.root_element().children().filter(XmlNode::is_element) {
            let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.name() == node.tag_name().name()) else {
                continue;
            };
            if node.attribute("action") == Some("delete") || node.attribute("visible") == Some("false") {
                continue;
            }
            match number(node, "id") {
                Ok(id) => {
                    let of_kind = match kind {
                        Kind::Node => &mut elements.nodes,
                        Kind::Way => &mut elements.ways,
                        Kind::Relation => &mut elements.relations,
                    };
                    if let Entry::Vacant(vacant) = of_kind.entry(id) {
                        vacant.insert(node);
                    } else {
                        elements.twice.insert(Element { kind, id });
                    }
                }
                Err(why) => {
                    skipped.add(SkippedKind::Element, || source.error(node, Element { kind, id: 0 }, why));
                }
            }
        }
        elements
    }

    /// An element that a lane needs.
    pub(crate) fn needed(&self, element: Element) -> Result<XmlNode<'a, 'a>, String> {
        let of_kind = match element.kind {
            Kind::Node => &self.nodes,
            Kind::Way => &self.ways,
            Kind::Relation => &self.relations,
        };
        match of_kind.get(&element.id) {
            _ if self.twice.contains(&element) => Err(format!("{element} is there twice")),
            Some(node) => Ok(*node),
            None => Err(format!("{element} is missing")),
        }
    }

    /// The error of a relation.
    pub(crate) fn error(&self, id: i64, problem: String) -> LaneMapError {
        let element = Element { kind: Kind::Relation, id };
        match self.relations.get(&id) {
            Some(node) => self.source.error(*node, element, problem),
            None => LaneMapError::Element { path: self.source.path.to_owned(), line: 0, element, problem },
        }
    }
}

pub(crate) fn members<'a>(relation: XmlNode<'a, 'a>) -> Result<Vec<Member<'a>>, String> {
    children(relation, "member", |node| Ok(Member::of(node)))
        .map(|members| members.into_iter().flatten().collect())
}

pub(crate) fn nodes_of(way: XmlNode<'_, '_>) -> Result<Vec<i64>, String> {
    children(way, "nd", |nd| number(nd, "ref"))
}

/// A way's geometry.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    pub(crate) way: i64,
    pub(crate) points_m: Vec<[f64; 2]>,
    /// First and last node.
    pub(crate) ends: [i64; 2],
}

impl Line {
    pub(crate) fn reverse(&mut self) {
        self.points_m.reverse();
        self.ends.reverse();
    }
}

impl<'a> Member<'a> {
    /// The member; `None` if OSM does not have its kind, or if it does not name an element.
    fn of(node: XmlNode<'a, 'a>) -> Option<Self> {
        let kind = Kind::ALL.into_iter().find(|kind| node.attribute("type") == Some(kind.name()))?;
        let element = Element { kind, id: number(node, "ref").ok()? };
        Some(Self { element, role: node.attribute("role").unwrap_or_default() })
    }
}

fn children<'a, T>(
    node: XmlNode<'a, 'a>,
    name: &str,
    read: impl Fn(XmlNode<'a, 'a>) -> Result<T, String>,
) -> Result<Vec<T>, String> {
    let mut all = Vec::new();
    for child in node.children().filter(|child| child.has_tag_name(name)) {
        if all.len() == MEMBERS_MAX {
            return Err(format!("more than {MEMBERS_MAX} of `{name}`"));
        }
        all.push(read(child)?);
    }
    Ok(all)
}

fn number(node: XmlNode<'_, '_>, name: &str) -> Result<i64, String> {
    let value = node.attribute(name).ok_or_else(|| format!("no `{name}`"))?;
    value.trim().parse().map_err(|_| format!("{name} = \"{}\": expected a whole number", shortened(value)))
}

/// A finite number.
pub(crate) fn real(name: &str, value: &str) -> Result<f64, String> {
    let number = value.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| format!("{name} = \"{}\": expected a number", shortened(value)))
}

/// Shortens a value for an error.
pub(crate) fn shortened(value: &str) -> String {
    const CHARACTERS_MAX: usize = 40;
    match value.char_indices().nth(CHARACTERS_MAX) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value.to_owned(),
    }
}
