//! The positions of lane nodes in the world frame.
//!
//! A map has one *own frame*. It is the tags `local_x` and `local_y` if any node of a lane has them, and
//! otherwise metres projected from latitude and longitude. [`Coordinates`] selects the origin that is
//! subtracted from it, in `f64`.

use std::collections::{BTreeMap, BTreeSet};

use roxmltree::Node as XmlNode;
use wire::{POSITION_MAX_M, WorldOrigin};

use crate::osm::{Elements, Line, Tags, members, nodes_of, real};
use crate::projection::Projector;
use crate::{Coordinates, Element, Kind, LaneMapError, Origin};

/// Tags of a node that contain its position in the map's own frame.
const LOCAL: [&str; 2] = ["local_x", "local_y"];

/// The positions of the nodes that lanes need.
pub(crate) struct Positions<'a, 'e> {
    elements: &'e Elements<'a>,
    frame: Frame,
    points_m: BTreeMap<i64, [f64; 2]>,
    /// A hint that brings the lanes within reach; empty if they are within reach.
    remedy: String,
}

/// The map's own frame minus an origin.
struct Frame {
    /// The projection; `None` if the local tags count.
    projector: Option<Projector>,
    origin_m: [f64; 2],
}

impl<'a, 'e> Positions<'a, 'e> {
    /// The positions of all nodes of lanes.
    ///
    /// # Errors
    /// [`LaneMapError::Element`] with the first node that has no position. The other positions are then
    /// doubtful.
    pub(crate) fn of(elements: &'e Elements<'a>, coordinates: Coordinates) -> Result<Self, LaneMapError> {
        let needed = nodes_of_lanes(elements);
        let has_local = |node: &XmlNode<'a, 'a>| LOCAL.iter().any(|name| Tags(*node).get(name).is_some());
        let is_local = needed.values().any(has_local);
        let frame = Frame::of(coordinates, is_local, &needed);
        let (mut points_m, mut without) = (BTreeMap::new(), Vec::new());
        for (&id, node) in &needed {
            match frame.position_m(*node) {
                Ok(position_m) => _ = points_m.insert(id, position_m),
                Err(why) => without.push((id, *node, why)),
            }
        }
        if let [(id, node, why), more @ ..] = &without[..] {
            let others = match more.len() {
                0 => String::new(),
                more => format!(", and {more} more nodes of lanes have no position"),
            };
            let element = Element { kind: Kind::Node, id: *id };
            return Err(elements.source.error(*node, element, format!("{why}{others}")));
        }
        let remedy = frame.remedy(&needed, &points_m);
        Ok(Self { elements, frame, points_m, remedy })
    }

    /// The positions of a way's nodes without repetitions, with its first and last node. Adds all elements of
    /// the way to `used`.
    pub(crate) fn line(&self, id: i64, used: &mut BTreeSet<Element>) -> Result<Line, String> {
        let element = Element { kind: Kind::Way, id };
        let way = self.elements.needed(element)?;
        used.insert(element);
        let in_way = |why: String| format!("{element}: {why}");
        let nodes = nodes_of(way).map_err(in_way)?;
        let mut points_m: Vec<[f64; 2]> = Vec::with_capacity(nodes.len());
        for &id in &nodes {
            let point_m = self.point_m(Element { kind: Kind::Node, id }).map_err(in_way)?;
            used.insert(Element { kind: Kind::Node, id });
            if points_m.last() != Some(&point_m) {
                points_m.push(point_m);
            }
        }
        match (nodes.first(), nodes.last()) {
            (Some(&first), Some(&last)) if points_m.len() > 1 => {
                Ok(Line { way: id, points_m, ends: [first, last] })
            }
            _ => Err(in_way(format!("{} different nodes, at least 2 make a line", points_m.len()))),
        }
    }

    fn point_m(&self, element: Element) -> Result<[f64; 2], String> {
        let node = self.elements.needed(element)?;
        let point_m = match self.points_m.get(&element.id) {
            Some(point_m) => *point_m,
            None => self.frame.position_m(node).map_err(|why| format!("{element}: {why}"))?,
        };
        if is_in_reach(point_m) {
            return Ok(point_m);
        }
        let at = self.frame.own(node);
        Err(format!("{element}: at {at}, beyond ±{POSITION_MAX_M} m of the origin{}", self.remedy))
    }
}

impl Frame {
    fn of(coordinates: Coordinates, is_local: bool, needed: &BTreeMap<i64, XmlNode<'_, '_>>) -> Self {
        let (projector, origin_m) = match coordinates {
            Coordinates::About(origin) => (Some(Projector::new(origin)), [0.0; 2]),
            Coordinates::Default if is_local => (None, [0.0; 2]),
            Coordinates::Default => (Some(Projector::new(Origin::default())), [0.0; 2]),
            Coordinates::Less(origin) if is_local => (None, origin.position_m()),
            Coordinates::Less(origin) => (Some(own_projector(needed)), origin.position_m()),
        };
        Self { projector, origin_m }
    }

    fn position_m(&self, node: XmlNode<'_, '_>) -> Result<[f64; 2], String> {
        let own_m = match &self.projector {
            None => local_m(node)?,
            Some(projector) => {
                let [latitude, longitude] = degrees(node)?;
                projector.project(latitude, longitude).unwrap_or([f64::INFINITY; 2])
            }
        };
        Ok([0, 1].map(|axis| own_m[axis] - self.origin_m[axis]))
    }

    /// The coordinates of a node as written in the map.
    fn own(&self, node: XmlNode<'_, '_>) -> String {
        match &self.projector {
            None => local_m(node).map(|[x, y]| format!("{x}, {y}")).unwrap_or_default(),
            Some(_) => degrees(node).map(|[lat, lon]| format!("lat {lat}, lon {lon}")).unwrap_or_default(),
        }
    }

    /// A hint with the option that brings most nodes within reach; empty if they are within reach.
    fn remedy(&self, needed: &BTreeMap<i64, XmlNode<'_, '_>>, points_m: &BTreeMap<i64, [f64; 2]>) -> String {
        let middle_m = medians(points_m.values().copied());
        if middle_m.is_none_or(is_in_reach) {
            return String::new();
        }
        let nodes = needed.values();
        if self.projector.is_some() {
            let Some([lat, lon]) = medians(nodes.filter_map(|node| degrees(*node).ok())) else {
                return String::new();
            };
            return format!(": give an origin near the lanes, --lanes-origin {lat:.2},{lon:.2}");
        }
        let near = medians(nodes.filter_map(|node| local_m(*node).ok())).and_then(WorldOrigin::near);
        near.map_or_else(String::new, |near| {
            format!(
                ": give an origin in metres near the lanes, --lanes-origin {near}m, or --origin {near} if the \
                 detections have such coordinates too"
            )
        })
    }
}

/// The projection of a map without local tags if the origin is in metres. It is about 0, 0 if the map is near
/// there (like the maps of INTERACTION), and otherwise UTM.
fn own_projector(needed: &BTreeMap<i64, XmlNode<'_, '_>>) -> Projector {
    let about_zero = Projector::new(Origin::default());
    let Some([latitude, longitude]) = medians(needed.values().filter_map(|node| degrees(*node).ok())) else {
        return about_zero;
    };
    let is_near_zero = about_zero.project(latitude, longitude).is_some_and(is_in_reach);
    let middle = Origin::new(latitude, longitude).filter(|_| !is_near_zero);
    middle.map_or(about_zero, Projector::utm)
}

/// The existing nodes of the bounds and middles of all lanelets.
fn nodes_of_lanes<'a>(elements: &Elements<'a>) -> BTreeMap<i64, XmlNode<'a, 'a>> {
    let mut needed = BTreeMap::new();
    let lanelets = elements.relations.values().filter(|node| Tags(**node).get("type") == Some("lanelet"));
    for member in lanelets.filter_map(|node| members(*node).ok()).flatten() {
        if member.element.kind != Kind::Way || !["left", "right", "centerline"].contains(&member.role) {
            continue;
        }
        let Some(way) = elements.ways.get(&member.element.id) else { continue };
        let nodes = nodes_of(*way).unwrap_or_default();
        needed.extend(nodes.into_iter().filter_map(|id| Some((id, *elements.nodes.get(&id)?))));
    }
    needed
}

fn local_m(node: XmlNode<'_, '_>) -> Result<[f64; 2], String> {
    let [x, y] = LOCAL.map(|name| match Tags(node).get(name) {
        Some(value) => real(name, value),
        None => Err(format!("no `{name}`, which other nodes of lanes have")),
    });
    Ok([x?, y?])
}

fn degrees(node: XmlNode<'_, '_>) -> Result<[f64; 2], String> {
    let [latitude, longitude] = ["lat", "lon"].map(|name| match node.attribute(name) {
        Some(value) => real(name, value),
        None => Err(format!("no `{name}`")),
    });
    Ok([latitude?, longitude?])
}

fn is_in_reach(point_m: [f64; 2]) -> bool {
    point_m.iter().all(|x| x.abs() <= f64::from(POSITION_MAX_M))
}

/// The median of each coordinate.
fn medians(points: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 2]> {
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = points.map(|[x, y]| (x, y)).unzip();
    x.sort_by(f64::total_cmp);
    y.sort_by(f64::total_cmp);
    Some([*x.get(x.len() / 2)?, *y.get(y.len() / 2)?])
}
