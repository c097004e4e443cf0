//! Lanes: where agents go according to a Lanelet2 map.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::Read;
use std::path::Path;

use roxmltree::Node as XmlNode;

use crate::geometry::{Sampled, align, near};
use crate::grid::Grid;
use crate::lane::{Lane, POINTS_MAX, Users};
use crate::osm::{self, Elements, Line, Member, Tags, XML_BYTES_MAX, members, shortened};
use crate::positions::Positions;
use crate::skipped::{Skipped, SkippedKind};
use crate::{Coordinates, Element, Kind, LaneMapError, tags};

/// Maximum number of lanes. A lanelet that is used both ways counts twice.
pub const LANES_MAX: usize = 200_000;
/// The lanes of a site, in the world frame.
#[derive(Clone, Debug)]
pub struct LaneMap {
    lanes: Vec<Lane>,
    areas: Vec<Area>,
    skipped: Skipped,
    grid: Grid,
}

/// An area of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    /// Number of the multipolygon in the file.
    pub id: i64,
    /// Whether vehicles must not enter the area, such as a traffic island or grass.
    pub is_keepout: bool,
    /// The outer bound, closed.
    pub outline_m: Vec<[f32; 2]>,
}

impl LaneMap {
    /// Reads a map from a file.
    ///
    /// # Errors
    /// [`LaneMapError`] with the file, and the line, number and value of the unusable element.
    pub fn open(path: &Path, coordinates: Coordinates) -> Result<Self, LaneMapError> {
        let io = |source| LaneMapError::Io { path: path.into(), source };
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(io)?;
        file.take(XML_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(io)?;
        Self::parse(&path.display().to_string(), &bytes, coordinates)
    }

    /// Reads a map from bytes. `path` appears in errors.
    ///
    /// # Errors
    /// Like [`LaneMap::open`].
    pub fn parse(path: &str, bytes: &[u8], coordinates: Coordinates) -> Result<Self, LaneMapError> {
        if bytes.len() as u64 > XML_BYTES_MAX {
            let problem = format!("{} bytes, at most {XML_BYTES_MAX} are read", bytes.len());
            return Err(LaneMapError::File { path: path.to_owned(), problem });
        }
        let text = str::from_utf8(bytes).map_err(|error| {
            let before = &bytes[..error.valid_up_to()];
            let line = before.iter().filter(|byte| **byte == b'\n').count() as u32 + 1;
            let column = before.iter().rev().take_while(|byte| **byte != b'\n').count() as u32 + 1;
            let problem = "not text: not UTF-8".to_owned();
            LaneMapError::Syntax { path: path.to_owned(), line, column, problem }
        })?;
        let document = osm::parse(path, text)?;
        let mut skipped = Skipped::default();
        let elements = Elements::of(path, &document, &mut skipped);
        let positions = Positions::of(&elements, coordinates)?;
        let (begun, used) = (Vec::new(), BTreeSet::new());
        Reading { elements: &elements, positions, begun, point_count: 0, used, skipped }.map()
    }

    /// The lanes, in the order of their numbers in the file.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// The areas, in the order of their numbers in the file.
    pub fn areas(&self) -> &[Area] {
        &self.areas
    }

    /// The content of the map that did not become lanes.
    pub const fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// Writes the places of lanes near a position into `found`, each once, in order. A lane is near if a
    /// point of its middle is within about `reach_m`.
    pub(crate) fn near(&self, position_m: [f32; 2], reach_m: f32, found: &mut Vec<u32>) {
        self.grid.near(position_m, reach_m, found);
    }
}

impl Area {
    /// Whether a position is inside the outer bound.
    #[must_use]
    pub fn contains(&self, [x, y]: [f32; 2]) -> bool {
        let next = self.outline_m.iter().cycle().skip(1);
        // A ray to the right crosses the bound an odd number of times if the position is inside.
        self.outline_m.iter().zip(next).fold(false, |inside, (a, b)| {
            let is_crossed =
                (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            inside != is_crossed
        })
    }
}

/// A lane, and the nodes at which its bounds begin and end.
struct Begun {
    lane: Lane,
    /// Left and right node at the start.
    start: [i64; 2],
    /// Left and right node at the end.
    end: [i64; 2],
    /// Way of each bound, and its first node in the direction of the lane.
    bounds: [(i64, i64); 2],
    /// Whether an agent may cross the bound from this lane.
    may_cross: [bool; 2],
}

/// The lanes during reading.
struct Reading<'a, 'e> {
    elements: &'e Elements<'a>,
    positions: Positions<'a, 'e>,
    begun: Vec<Begun>,
    point_count: usize,
    /// The elements that lanes and areas need.
    used: BTreeSet<Element>,
    skipped: Skipped,
}

impl<'a> Reading<'a, '_> {
    fn map(mut self) -> Result<LaneMap, LaneMapError> {
        let elements = self.elements;
        let unusable =
            |problem: String| LaneMapError::File { path: elements.source.path.to_owned(), problem };
        let (mut areas, mut first_error) = (Vec::new(), None);
        for (&id, relation) in &elements.relations {
            let failed = |why: String| elements.error(id, why);
            match Tags(*relation).get("type") {
                Some("lanelet") => {
                    if let Err(why) = self.lanelet(id) {
                        self.skipped.add(SkippedKind::Lanelet, || failed(why.clone()));
                        first_error.get_or_insert_with(|| failed(why));
                    }
                }
                Some("multipolygon") => match self.area(id) {
                    Ok(area) => areas.extend(area),
                    Err(why) => self.skipped.add(SkippedKind::Area, || failed(why)),
                },
                _ => (),
            }
            if self.begun.len() > LANES_MAX {
                return Err(unusable(format!("more than {LANES_MAX} lanes")));
            }
            if self.point_count > POINTS_MAX {
                return Err(unusable(format!("more than {POINTS_MAX} metres of lanes")));
            }
        }
        if self.begun.is_empty() {
            return Err(first_error.unwrap_or_else(|| unusable("no lanelet".to_owned())));
        }
        let all = [elements.nodes.len(), elements.ways.len(), elements.relations.len()];
        self.skipped.unneeded = Kind::ALL
            .map(|kind| all[kind as usize] - self.used.iter().filter(|element| element.kind == kind).count());
        let lanes = joined(self.begun);
        let grid = Grid::of(&lanes);
        Ok(LaneMap { lanes, areas, skipped: self.skipped, grid })
    }

    /// A used relation, with its members.
    fn relation(&mut self, id: i64) -> Result<(Tags<'a>, Vec<Member<'a>>), String> {
        let element = Element { kind: Kind::Relation, id };
        let node: XmlNode<'a, 'a> = self.elements.needed(element)?;
        self.used.insert(element);
        Ok((Tags(node), members(node)?))
    }

    /// Adds a lanelet, in both directions if it is used both ways.
    fn lanelet(&mut self, id: i64) -> Result<(), String> {
        let (tags, members) = self.relation(id)?;
        let mut odd = Vec::new();
        let users = tags::users(tags, &mut odd);
        if users.is_empty() {
            return Ok(());
        }
        let both_ways = !tags::is_one_way(tags, &mut odd);
        let (mut left, mut right) = (self.only_line(&members, "left")?, self.only_line(&members, "right")?);
        align(&mut left, &mut right)?;
        let given = members.iter().any(|member| member.role == "centerline");
        let given = given.then(|| self.only_line(&members, "centerline")).transpose()?;
        let elements = self.elements;
        for why in odd {
            self.skipped.add(SkippedKind::Tag, || elements.error(id, why));
        }
        let limit_mps = self.limit_mps(id, tags, &members);
        let sampled = Sampled::of(&left, &right, given.as_ref());
        for is_reversed in [false, true] {
            if is_reversed && !both_ways {
                continue;
            }
            let sampled = if is_reversed { sampled.clone().reversed() } else { sampled.clone() };
            if is_reversed {
                std::mem::swap(&mut left, &mut right);
                left.reverse();
                right.reverse();
            }
            let may_cross = [(&left, 0), (&right, 1)].map(|(line, side)| {
                elements.ways.get(&line.way).is_some_and(|way| {
                    let first = osm::nodes_of(*way).ok().and_then(|nodes| nodes.first().copied());
                    tags::may_cross(Tags(*way), side, first == Some(line.ends[0]))
                })
            });
            self.point_count += sampled.centre_m.len() + left.points_m.len() + right.points_m.len();
            let lane = sampled.lane(id, users, limit_mps, [&left, &right]);
            self.begun.push(Begun {
                lane,
                start: [left.ends[0], right.ends[0]],
                end: [left.ends[1], right.ends[1]],
                bounds: [(left.way, left.ends[0]), (right.way, right.ends[0])],
                may_cross,
            });
        }
        Ok(())
    }

    /// The line of the only way with a role.
    fn only_line(&mut self, members: &[Member<'a>], role: &str) -> Result<Line, String> {
        let of_role = || members.iter().filter(|member| member.role == role);
        let mut ways = of_role().filter(|member| member.element.kind == Kind::Way);
        match (ways.next(), of_role().count()) {
            (Some(member), 1) => self
                .positions
                .line(member.element.id, &mut self.used)
                .map_err(|why| format!("role `{role}`: {why}")),
            (_, len) => Err(format!("{len} members of role `{role}`, expected 1 way")),
        }
    }

    /// The speed limit from the lanelet's own tag or one of its regulatory elements, or else the usual limit
    /// of its kind of road.
    fn limit_mps(&mut self, id: i64, tags: Tags<'a>, members: &[Member<'a>]) -> Option<f32> {
        let elements = self.elements;
        let odd = |key: &str, value: &str| format!("{key} = \"{}\" is not a speed", shortened(value));
        if let Some(value) = tags.get("speed_limit") {
            match tags::speed_mps(value) {
                Some(limit_mps) => return Some(limit_mps),
                None => {
                    self.skipped.add(SkippedKind::Limit, || elements.error(id, odd("speed_limit", value)));
                }
            }
        }
        for member in members.iter().filter(|member| member.role == "regulatory_element") {
            let rule = member.element;
            let Some(node) = elements.relations.get(&rule.id).filter(|_| rule.kind == Kind::Relation) else {
                self.skipped.add(SkippedKind::Rule, || elements.error(id, format!("{rule} is missing")));
                continue;
            };
            let tags = Tags(*node);
            if tags.get("subtype") != Some("speed_limit") {
                continue;
            }
            self.used.insert(rule);
            let given = ["sign_type", "speed_limit", "max_speed"].map(|key| Some((key, tags.get(key)?)));
            let mut given = given.into_iter().flatten();
            if let Some(limit_mps) = given.clone().find_map(|(_, value)| tags::speed_mps(value)) {
                return Some(limit_mps);
            }
            if let Some((key, value)) = given.next() {
                self.skipped.add(SkippedKind::Limit, || elements.error(rule.id, odd(key, value)));
            }
        }
        tags::usual_limit_mps(tags)
    }

    /// The area, if its outer bound encloses one.
    fn area(&mut self, id: i64) -> Result<Option<Area>, String> {
        let (tags, members) = self.relation(id)?;
        let mut outline_m: Vec<[f32; 2]> = Vec::new();
        let mut last_node = None;
        for member in members.iter().filter(|member| member.role == "outer") {
            let line = self.positions.line(member.element.id, &mut self.used);
            let mut line = line.map_err(|why| format!("role `outer`: {why}"))?;
            if last_node == Some(line.ends[1]) && last_node != Some(line.ends[0]) {
                line.reverse();
            }
            last_node = Some(line.ends[1]);
            outline_m.extend(line.points_m.iter().map(near));
        }
        let is_keepout = tags.get("subtype") == Some("keepout");
        Ok((outline_m.len() > 2).then_some(Area { id, is_keepout, outline_m }))
    }
}

/// Finds the successors and the neighbours of each lane.
fn joined(begun: Vec<Begun>) -> Vec<Lane> {
    let mut by_start: BTreeMap<[i64; 2], Vec<u32>> = BTreeMap::new();
    let mut by_bound: [BTreeMap<(i64, i64), u32>; 2] = Default::default();
    for (place, begun) in begun.iter().enumerate() {
        by_start.entry(begun.start).or_default().push(place as u32);
        for (side, bound) in begun.bounds.into_iter().enumerate() {
            by_bound[side].entry(bound).or_insert(place as u32);
        }
    }
    let users: Vec<Users> = begun.iter().map(|begun| begun.lane.users).collect();
    let shares_users = |place: u32, own: Users| users[place as usize].shares_any(own);
    let mut lanes = Vec::with_capacity(begun.len());
    for (place, mut begun) in begun.into_iter().enumerate() {
        let own = begun.lane.users;
        let next = by_start.get(&begun.end).into_iter().flatten().copied();
        begun.lane.successors =
            next.filter(|&next| next != place as u32 && shares_users(next, own)).collect();
        begun.lane.neighbours = [0, 1].map(|side| {
            // The left bound of this lane is the right bound of the lane to its left.
            let there = by_bound[1 - side].get(&begun.bounds[side]).copied();
            there.filter(|&there| begun.may_cross[side] && shares_users(there, own))
        });
        lanes.push(begun.lane);
    }
    lanes
}
