//! OSM XML: nodes, ways and relations by number, with their tags.

use std::collections::BTreeMap;

use roxmltree::{Document, Node as XmlNode, ParsingOptions};

use crate::projection::Projector;
use crate::{Coordinates, Element, Kind, LaneMapError};

/// Size of the largest file that is read: in memory it takes several times as much.
pub const XML_BYTES_MAX: u64 = 256 << 20;
/// Most elements, texts and comments of a file.
const XML_NODES_MAX: u32 = 16_000_000;
/// Most nodes, ways and relations of each kind.
pub const ELEMENTS_MAX: usize = 2_000_000;
/// Most nodes of a way, and members of a relation.
pub const MEMBERS_MAX: usize = 10_000;

/// The tags of an element; of two with the same key the first counts.
#[derive(Clone, Copy)]
pub(crate) struct Tags<'a>(XmlNode<'a, 'a>);

/// A node, in metres.
pub(crate) struct Point {
    pub(crate) position_m: [f64; 2],
}

/// A line of nodes.
pub(crate) struct Way<'a> {
    pub(crate) nodes: Vec<i64>,
    pub(crate) tags: Tags<'a>,
}

/// A set of elements with roles.
pub(crate) struct Relation<'a> {
    pub(crate) members: Vec<Member<'a>>,
    pub(crate) tags: Tags<'a>,
    pub(crate) line: u32,
}

/// An element's part in a relation.
pub(crate) struct Member<'a> {
    pub(crate) element: Element,
    pub(crate) role: &'a str,
}

/// The elements of a file, those that it marks as deleted left out.
pub(crate) struct Elements<'a> {
    pub(crate) source: Source<'a>,
    pub(crate) points: BTreeMap<i64, Point>,
    pub(crate) ways: BTreeMap<i64, Way<'a>>,
    pub(crate) relations: BTreeMap<i64, Relation<'a>>,
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

    /// The error of an element.
    pub(crate) fn error(&self, line: u32, element: Element, problem: String) -> LaneMapError {
        LaneMapError::Element { path: self.path.to_owned(), line, element, problem }
    }
}

impl<'a> Tags<'a> {
    /// The value of a key.
    pub(crate) fn get(self, key: &str) -> Option<&'a str> {
        self.iter().find(|(own, _)| *own == key).map(|(_, value)| value)
    }

    /// Whether a tag says yes; none where it is not there.
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

impl<'a> Elements<'a> {
    /// The elements of a document.
    pub(crate) fn of(
        path: &'a str,
        document: &'a Document<'a>,
        coordinates: Coordinates,
    ) -> Result<Self, LaneMapError> {
        let source = Source { path, document };
        let (mut points, mut ways, mut relations) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        let projection = Projection { coordinates, projector: Projector::new(coordinates.origin()) };
        for node in document.root_element().children().filter(XmlNode::is_element) {
            let kind = match node.tag_name().name() {
                "node" => Kind::Node,
                "way" => Kind::Way,
                "relation" => Kind::Relation,
                _ => continue,
            };
            if node.attribute("action") == Some("delete") || node.attribute("visible") == Some("false") {
                continue;
            }
            let line = source.line(node);
            let id = number(node, "id").map_err(|why| source.error(line, Element { kind, id: 0 }, why))?;
            let element = Element { kind, id };
            let failed = |why: String| source.error(line, element, why);
            let tags = Tags(node);
            let is_new = match kind {
                Kind::Node => {
                    let position_m = projection.position_m(node, tags).map_err(failed)?;
                    points.insert(id, Point { position_m }).is_none()
                }
                Kind::Way => {
                    let nodes = children(node, "nd", |nd| number(nd, "ref")).map_err(failed)?;
                    ways.insert(id, Way { nodes, tags }).is_none()
                }
                Kind::Relation => {
                    let members = children(node, "member", Member::of).map_err(failed)?;
                    let members = members.into_iter().flatten().collect();
                    relations.insert(id, Relation { members, tags, line }).is_none()
                }
            };
            if !is_new {
                return Err(failed("a second one of this number".to_owned()));
            }
            for (what, len) in [("nodes", points.len()), ("ways", ways.len()), ("relations", relations.len())]
            {
                if len > ELEMENTS_MAX {
                    return Err(LaneMapError::TooMany { path: path.to_owned(), what, most: ELEMENTS_MAX });
                }
            }
        }
        Ok(Self { source, points, ways, relations })
    }

    /// The error of a relation.
    pub(crate) fn error(&self, id: i64, problem: String) -> LaneMapError {
        let line = self.relations.get(&id).map_or(0, |relation| relation.line);
        self.source.error(line, Element { kind: Kind::Relation, id }, problem)
    }

    /// The positions of a way's nodes, without repeated ones, and its first and last node.
    ///
    /// # Errors
    /// The problem, where the way or one of its nodes is missing, or fewer than two differ.
    pub(crate) fn line(&self, id: i64) -> Result<Line, String> {
        let way = self.ways.get(&id).ok_or_else(|| format!("way {id} is missing"))?;
        let mut points_m: Vec<[f64; 2]> = Vec::with_capacity(way.nodes.len());
        for node in &way.nodes {
            let point = self.points.get(node).ok_or_else(|| format!("way {id}: node {node} is missing"))?;
            if points_m.last() != Some(&point.position_m) {
                points_m.push(point.position_m);
            }
        }
        match (way.nodes.first(), way.nodes.last()) {
            (Some(&first), Some(&last)) if points_m.len() > 1 => {
                Ok(Line { way: id, points_m, ends: [first, last] })
            }
            _ => Err(format!("way {id}: {} different nodes, at least 2 make a line", points_m.len())),
        }
    }
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
    /// The member; none where it is of a kind that OSM does not have.
    fn of(node: XmlNode<'a, 'a>) -> Result<Option<Self>, String> {
        let kind = match attribute(node, "type")? {
            "node" => Kind::Node,
            "way" => Kind::Way,
            "relation" => Kind::Relation,
            _ => return Ok(None),
        };
        let element = Element { kind, id: number(node, "ref")? };
        Ok(Some(Self { element, role: node.attribute("role").unwrap_or_default() }))
    }
}

/// How nodes become metres.
struct Projection {
    coordinates: Coordinates,
    projector: Projector,
}

impl Projection {
    fn position_m(&self, node: XmlNode<'_, '_>, tags: Tags<'_>) -> Result<[f64; 2], String> {
        let local = [tags.get("local_x"), tags.get("local_y")];
        let position_m = match (self.coordinates, local) {
            (Coordinates::Default, [Some(x), Some(y)]) => [real("local_x", x)?, real("local_y", y)?],
            _ => {
                let degrees = |name| attribute(node, name).and_then(|value| real(name, value));
                let (latitude, longitude) = (degrees("lat")?, degrees("lon")?);
                let projected = self.projector.project(latitude, longitude);
                projected
                    .ok_or_else(|| format!("lat = {latitude}, lon = {longitude}: too far from the origin"))?
            }
        };
        match position_m.iter().find(|x| x.abs() > f64::from(wire::POSITION_MAX_M)) {
            Some(beyond) => Err(format!(
                "at {beyond:.0} m, at most ±{} m from the origin are mapped",
                wire::POSITION_MAX_M
            )),
            None => Ok(position_m),
        }
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

fn attribute<'a>(node: XmlNode<'a, 'a>, name: &str) -> Result<&'a str, String> {
    let tag = node.tag_name().name();
    node.attribute(name).ok_or_else(|| format!("`{tag}` has no `{name}`"))
}

fn number(node: XmlNode<'_, '_>, name: &str) -> Result<i64, String> {
    let value = node.attribute(name).ok_or_else(|| format!("no `{name}`"))?;
    value.trim().parse().map_err(|_| format!("{name} = \"{}\": expected a whole number", shortened(value)))
}

/// A finite number.
fn real(name: &str, value: &str) -> Result<f64, String> {
    let number = value.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| format!("{name} = \"{}\": expected a number", shortened(value)))
}

/// A value that fits an error.
pub(crate) fn shortened(value: &str) -> String {
    const CHARACTERS_MAX: usize = 40;
    match value.char_indices().nth(CHARACTERS_MAX) {
        Some((end, _)) => format!("{}…", &value[..end]),
        None => value.to_owned(),
    }
}
