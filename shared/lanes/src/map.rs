//! Lanes: what a Lanelet2 map says of where agents go.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use wire::AgentType;

use crate::grid::Grid;
use crate::osm::{self, Elements, Line, Relation, Tags, XML_BYTES_MAX, shortened};
use crate::{Coordinates, Kind, LaneMapError, tags};

/// Most lanes: a lanelet that is used both ways counts twice.
pub const LANES_MAX: usize = 200_000;
/// Most points of all lanes together.
pub const POINTS_MAX: usize = 8_000_000;
/// Distance between the points of a lane, at most.
pub const SPACING_M: f64 = 1.0;

/// The lanes of a site, in the world frame.
#[derive(Clone, Debug)]
pub struct LaneMap {
    lanes: Vec<Lane>,
    areas: Vec<Area>,
    grid: Grid,
}

/// A lanelet in one direction.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Number of the lanelet in the file.
    pub id: i64,
    /// Types of agents that use it.
    pub users: Users,
    /// Speed limit; none where neither the map nor its kind of road has one.
    pub limit_mps: Option<f32>,
    /// Points along the middle, at most [`SPACING_M`] apart, two or more, all different.
    pub centre_m: Vec<[f32; 2]>,
    /// Half of the width at each point.
    pub half_width_m: Vec<f32>,
    /// Length along the middle up to each point.
    pub along_m: Vec<f32>,
    /// Where along the lane there are lines to stop or yield at.
    pub stops_m: Vec<f32>,
    /// The bounds, left and right, in the direction of the lane.
    pub bounds_m: [Vec<[f32; 2]>; 2],
    /// Places in [`LaneMap::lanes`] of the lanes that begin where this one ends.
    pub successors: Vec<u32>,
    /// Places of the lanes to the left and to the right that one may change to.
    pub beside: [Option<u32>; 2],
}

/// An area of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    /// Number of the multipolygon in the file.
    pub id: i64,
    /// Whether nothing drives there: a traffic island, or grass.
    pub is_keepout: bool,
    /// Its outer bound, closed.
    pub outline_m: Vec<[f32; 2]>,
}

/// Types of agents, a bit each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Users(u8);

impl Users {
    /// These types.
    #[must_use]
    pub fn of(types: &[AgentType]) -> Self {
        Self(types.iter().fold(0, |bits, &agent_type| bits | 1 << agent_type as u8))
    }

    /// Whether a type is among them.
    #[must_use]
    pub const fn contain(self, agent_type: AgentType) -> bool {
        self.0 & 1 << agent_type as u8 != 0
    }

    pub(crate) const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl LaneMap {
    /// Reads a map from a file.
    ///
    /// # Errors
    /// [`LaneMapError`] with the file, and the line, number and value of the element that can't be used.
    pub fn open(path: &Path, coordinates: Coordinates) -> Result<Self, LaneMapError> {
        let io = |source| LaneMapError::Io { path: path.into(), source };
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(io)?;
        file.take(XML_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(io)?;
        Self::parse(&path.display().to_string(), &bytes, coordinates)
    }

    /// Reads a map from bytes; `path` is for errors.
    ///
    /// # Errors
    /// As [`LaneMap::open`].
    pub fn parse(path: &str, bytes: &[u8], coordinates: Coordinates) -> Result<Self, LaneMapError> {
        if bytes.len() as u64 > XML_BYTES_MAX {
            let (bytes, most) = (bytes.len() as u64, XML_BYTES_MAX);
            return Err(LaneMapError::TooLarge { path: path.to_owned(), bytes, most });
        }
        let text = str::from_utf8(bytes).map_err(|error| {
            let before = &bytes[..error.valid_up_to()];
            let line = before.iter().filter(|byte| **byte == b'\n').count() as u32 + 1;
            let column = before.iter().rev().take_while(|byte| **byte != b'\n').count() as u32 + 1;
            let problem = "not text: not UTF-8".to_owned();
            LaneMapError::Syntax { path: path.to_owned(), line, column, problem }
        })?;
        let document = osm::parse(path, text)?;
        let elements = Elements::of(path, &document, coordinates)?;
        Reading::new(&elements).map()
    }

    /// The lanes, in the order of their numbers in the file.
    #[must_use]
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// The areas, in the order of their numbers in the file.
    #[must_use]
    pub fn areas(&self) -> &[Area] {
        &self.areas
    }

    /// Writes into `found` the places of lanes with a point of their middle within about `reach_m` of a
    /// position, each once, in order.
    pub(crate) fn near(&self, position_m: [f32; 2], reach_m: f32, found: &mut Vec<u32>) {
        self.grid.near(position_m, reach_m, found);
    }
}

impl Area {
    /// Whether a position lies inside the outer bound.
    #[must_use]
    pub fn contains(&self, [x, y]: [f32; 2]) -> bool {
        let next = self.outline_m.iter().cycle().skip(1);
        // A ray to the right crosses the bound an odd number of times.
        self.outline_m.iter().zip(next).fold(false, |inside, (a, b)| {
            let is_crossed =
                (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            inside != is_crossed
        })
    }
}

impl Lane {
    /// Length along the middle.
    #[must_use]
    pub fn length_m(&self) -> f32 {
        self.along_m.last().copied().unwrap_or(0.0)
    }
}

/// A lane, and where its bounds begin and end.
struct Begun {
    lane: Lane,
    /// Left and right node at the start.
    start: [i64; 2],
    /// Left and right node at the end.
    end: [i64; 2],
    /// Way of each bound, and its first node in the direction of the lane.
    bounds: [(i64, i64); 2],
    /// Whether one may cross the bound from here.
    may_cross: [bool; 2],
}

/// The lanes as they are read.
struct Reading<'a, 'e> {
    elements: &'e Elements<'a>,
    begun: Vec<Begun>,
    points_len: usize,
}

impl<'a, 'e> Reading<'a, 'e> {
    const fn new(elements: &'e Elements<'a>) -> Self {
        Self { elements, begun: Vec::new(), points_len: 0 }
    }

    /// The lines at which a lanelet's regulatory elements have it stop or yield.
    fn stop_lines(&self, relation: &Relation<'a>, id: i64) -> Result<Vec<Line>, String> {
        let mut lines = Vec::new();
        for member in relation.members.iter().filter(|member| member.role == "regulatory_element") {
            let Some(rule) = self.elements.relations.get(&member.element.id) else { continue };
            let of_rule = |role: &str, wanted: i64| {
                let mut members = rule.members.iter();
                members.any(|member| member.role == role && member.element.id == wanted)
            };
            let is_bound = match rule.tags.get("subtype") {
                Some("right_of_way") => of_rule("yield", id),
                Some("all_way_stop" | "traffic_sign" | "traffic_light") => true,
                _ => false,
            };
            if !is_bound {
                continue;
            }
            for line in rule.members.iter().filter(|member| member.role == "ref_line") {
                let why = |why| format!("relation {}: role `ref_line`: {why}", member.element.id);
                lines.push(self.elements.line(line.element.id).map_err(why)?);
            }
        }
        Ok(lines)
    }

    fn map(mut self) -> Result<LaneMap, LaneMapError> {
        let elements = self.elements;
        let mut areas = Vec::new();
        for (&id, relation) in &elements.relations {
            match relation.tags.get("type") {
                Some("lanelet") => self.lanelet(id, relation)?,
                Some("multipolygon") => areas.extend(self.area(id, relation)?),
                _ => (),
            }
            let too_many =
                |what, most| Err(LaneMapError::TooMany { path: elements.source.path.to_owned(), what, most });
            if self.begun.len() > LANES_MAX {
                return too_many("lanes", LANES_MAX);
            }
            if self.points_len > POINTS_MAX {
                return too_many("metres of lanes", POINTS_MAX);
            }
        }
        if self.begun.is_empty() {
            return Err(LaneMapError::NoLanelets { path: elements.source.path.to_owned() });
        }
        let lanes = joined(self.begun);
        let grid = Grid::of(&lanes);
        Ok(LaneMap { lanes, areas, grid })
    }

    /// Adds a lanelet, in both directions where it is used so.
    fn lanelet(&mut self, id: i64, relation: &Relation<'a>) -> Result<(), LaneMapError> {
        let elements = self.elements;
        let failed = |problem: String| elements.error(id, problem);
        let users = tags::users(relation.tags).map_err(failed)?;
        if users.is_empty() {
            return Ok(());
        }
        let bound = |role: &str| self.only_line(relation, role);
        let (mut left, mut right) = (bound("left").map_err(failed)?, bound("right").map_err(failed)?);
        align(&mut left, &mut right).map_err(failed)?;
        let given = relation.members.iter().any(|member| member.role == "centerline");
        let given = given.then(|| self.only_line(relation, "centerline")).transpose().map_err(failed)?;
        let limit_mps = self.limit_mps(relation).map_err(failed)?;
        let both_ways = !tags::is_one_way(relation.tags).map_err(failed)?;
        let sampled = Sampled::of(&left, &right, given.as_ref());
        let stop_lines = self.stop_lines(relation, id).map_err(failed)?;
        let tags_of = |line: &Line| elements.ways.get(&line.way).map(|way| way.tags);
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
                let first = elements.ways.get(&line.way).and_then(|way| way.nodes.first().copied());
                let is_along = first == Some(line.ends[0]);
                tags_of(line).is_some_and(|tags| tags::may_cross(tags, side, is_along))
            });
            self.points_len += sampled.centre_m.len() + left.points_m.len() + right.points_m.len();
            let mut lane = sampled.lane(id, users, limit_mps, [&left, &right]);
            let mut stops_m: Vec<f32> =
                stop_lines.iter().filter_map(|line| crossing_m(&lane, line)).collect();
            stops_m.sort_by(f32::total_cmp);
            lane.stops_m = stops_m;
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
    fn only_line(&self, relation: &Relation<'a>, role: &str) -> Result<Line, String> {
        let of_role = || relation.members.iter().filter(|member| member.role == role);
        let mut ways = of_role().filter(|member| member.element.kind == Kind::Way);
        match (ways.next(), of_role().count()) {
            (Some(member), 1) => {
                self.elements.line(member.element.id).map_err(|why| format!("role `{role}`: {why}"))
            }
            (_, len) => Err(format!("{len} members of role `{role}`, expected 1 way")),
        }
    }

    /// The limit that the lanelet's own tag or one of its regulatory elements has, else that of its kind of
    /// road.
    fn limit_mps(&self, relation: &Relation<'a>) -> Result<Option<f32>, String> {
        if let Some(value) = relation.tags.get("speed_limit") {
            let limit = tags::speed_mps(value);
            let why = || format!("speed_limit = \"{}\": expected a speed such as 50 km/h", shortened(value));
            return limit.ok_or_else(why).map(Some);
        }
        for member in relation.members.iter().filter(|member| member.role == "regulatory_element") {
            let id = member.element.id;
            let rule = self.elements.relations.get(&id);
            let rule = rule.ok_or_else(|| format!("role `regulatory_element`: relation {id} is missing"))?;
            if rule.tags.get("subtype") == Some("speed_limit") {
                let value =
                    ["sign_type", "speed_limit", "max_speed"].into_iter().find_map(|key| rule.tags.get(key));
                if let Some(limit) = value.and_then(tags::speed_mps) {
                    return Ok(Some(limit));
                }
            }
        }
        Ok(tags::usual_limit_mps(relation.tags))
    }

    /// The area, where its outer bound encloses one.
    fn area(&self, id: i64, relation: &Relation<'a>) -> Result<Option<Area>, LaneMapError> {
        let mut outline_m: Vec<[f32; 2]> = Vec::new();
        let mut last_node = None;
        for member in relation.members.iter().filter(|member| member.role == "outer") {
            let line = self.elements.line(member.element.id);
            let mut line = line.map_err(|why| self.elements.error(id, format!("role `outer`: {why}")))?;
            if last_node == Some(line.ends[1]) && last_node != Some(line.ends[0]) {
                line.reverse();
            }
            last_node = Some(line.ends[1]);
            outline_m.extend(line.points_m.iter().map(near));
        }
        let is_keepout = relation.tags.get("subtype") == Some("keepout");
        Ok((outline_m.len() > 2).then_some(Area { id, is_keepout, outline_m }))
    }
}

/// A lane's middle and bounds at points about [`SPACING_M`] apart.
#[derive(Clone)]
struct Sampled {
    centre_m: Vec<[f32; 2]>,
    half_width_m: Vec<f32>,
}

impl Sampled {
    fn of(left: &Line, right: &Line, given: Option<&Line>) -> Self {
        let bounds = [left, right].map(|line| Measured::new(&line.points_m));
        let longest_m = bounds.iter().map(Measured::length_m).fold(0.0, f64::max);
        let given = given.map(|line| {
            let starts_at = |point: [f64; 2]| distance(point, left.points_m[0]);
            let mut points_m = line.points_m.clone();
            if starts_at(points_m[points_m.len() - 1]) < starts_at(points_m[0]) {
                points_m.reverse();
            }
            Measured::new(&points_m)
        });
        let steps = (longest_m / SPACING_M).ceil().clamp(1.0, POINTS_MAX as f64) as usize;
        let mut sampled = Self { centre_m: Vec::new(), half_width_m: Vec::new() };
        for step in 0..=steps {
            let share = step as f64 / steps as f64;
            let [l, r] = bounds.each_ref().map(|bound| bound.at(share));
            let middle = [0, 1].map(|axis| 0.5 * (l[axis] + r[axis]));
            let centre_m = near(&given.as_ref().map_or(middle, |given| given.at(share)));
            if sampled.centre_m.last() != Some(&centre_m) {
                sampled.centre_m.push(centre_m);
                sampled.half_width_m.push((0.5 * distance(l, r)) as f32);
            }
        }
        if let ([only], Some(end)) = (&sampled.centre_m[..], left.points_m.last()) {
            // Bounds that cross: any second point gives the lane a direction.
            let beside = [only[0], only[1] + 0.01_f32.max((end[1].abs() * 1e-6) as f32)];
            sampled.centre_m.push(beside);
            sampled.half_width_m.push(0.0);
        }
        sampled
    }

    fn reversed(mut self) -> Self {
        self.centre_m.reverse();
        self.half_width_m.reverse();
        self
    }

    fn lane(self, id: i64, users: Users, limit_mps: Option<f32>, bounds: [&Line; 2]) -> Lane {
        let mut along_m = vec![0.0_f32];
        for (before, after) in self.centre_m.iter().zip(&self.centre_m[1..]) {
            let last_m = along_m.last().copied().unwrap_or(0.0);
            along_m.push(last_m + (after[0] - before[0]).hypot(after[1] - before[1]));
        }
        Lane {
            id,
            users,
            limit_mps,
            centre_m: self.centre_m,
            half_width_m: self.half_width_m,
            along_m,
            stops_m: Vec::new(),
            bounds_m: bounds.map(|line| line.points_m.iter().map(near).collect()),
            successors: Vec::new(),
            beside: [None; 2],
        }
    }
}

/// A line with the length up to each of its points.
struct Measured {
    points_m: Vec<[f64; 2]>,
    along_m: Vec<f64>,
}

impl Measured {
    fn new(points_m: &[[f64; 2]]) -> Self {
        let mut along_m = vec![0.0];
        for pair in points_m.windows(2) {
            along_m.push(along_m.last().copied().unwrap_or(0.0) + distance(pair[0], pair[1]));
        }
        Self { points_m: points_m.to_vec(), along_m }
    }

    fn length_m(&self) -> f64 {
        self.along_m.last().copied().unwrap_or(0.0)
    }

    /// The point at a share of the length.
    fn at(&self, share: f64) -> [f64; 2] {
        let wanted_m = share * self.length_m();
        let after =
            self.along_m.partition_point(|along_m| *along_m < wanted_m).clamp(1, self.points_m.len() - 1);
        let (from, to) = (self.points_m[after - 1], self.points_m[after]);
        let (from_m, to_m) = (self.along_m[after - 1], self.along_m[after]);
        let part = if to_m > from_m { ((wanted_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0) } else { 0.0 };
        [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))
    }
}

/// Turns two bounds into the direction of their lanelet: both the same way, the left one on the left.
fn align(left: &mut Line, right: &mut Line) -> Result<(), String> {
    let ends = |line: &Line| [line.points_m[0], line.points_m[line.points_m.len() - 1]];
    let ([l0, l1], [r0, r1]) = (ends(left), ends(right));
    if distance(l0, r0) + distance(l1, r1) > distance(l0, r1) + distance(l1, r0) {
        right.reverse();
    }
    let around = left.points_m.iter().chain(right.points_m.iter().rev());
    let area = signed_area(around);
    if area == 0.0 {
        return Err(format!("ways {} and {} enclose no area", left.way, right.way));
    }
    if area > 0.0 {
        left.reverse();
        right.reverse();
    }
    Ok(())
}

/// Where along a lane a line crosses its middle, or the end of it where the line lies right beyond.
fn crossing_m(lane: &Lane, line: &Line) -> Option<f32> {
    const BEYOND_M: f32 = 2.0;
    let last = lane.centre_m.len() - 1;
    for pair in line.points_m.windows(2) {
        let [a, b] = [near(&pair[0]), near(&pair[1])];
        for (number, segment) in lane.centre_m.windows(2).enumerate() {
            let along = [0, 1].map(|axis| segment[1][axis] - segment[0][axis]);
            let length_m = along[0].hypot(along[1]).max(1e-6);
            let side = |p: [f32; 2]| along[0] * (p[1] - segment[0][1]) - along[1] * (p[0] - segment[0][0]);
            let (of_a, of_b) = (side(a), side(b));
            if of_a * of_b > 0.0 || of_a == of_b {
                continue;
            }
            let part = of_a / (of_a - of_b);
            let at = [0, 1].map(|axis| a[axis] + part * (b[axis] - a[axis]) - segment[0][axis]);
            let at_m = (at[0] * along[0] + at[1] * along[1]) / length_m;
            let most_m = length_m + if number + 1 == last { BEYOND_M } else { 0.0 };
            if (0.0..=most_m).contains(&at_m) {
                return Some((lane.along_m[number] + at_m).min(lane.length_m()));
            }
        }
    }
    None
}

/// Twice the area inside a closed line; positive where it runs counter-clockwise.
fn signed_area<'p>(points_m: impl Iterator<Item = &'p [f64; 2]> + Clone) -> f64 {
    // About the first point, so that nothing cancels far from the origin.
    let Some(&[x0, y0]) = points_m.clone().next() else { return 0.0 };
    let next = points_m.clone().cycle().skip(1);
    points_m.zip(next).map(|(a, b)| (a[0] - x0) * (b[1] - y0) - (b[0] - x0) * (a[1] - y0)).sum()
}

/// Finds for each lane those that follow it and those beside it.
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
    let shares_users = |place: u32, own: Users| users[place as usize].0 & own.0 != 0;
    let mut lanes = Vec::with_capacity(begun.len());
    for (place, mut begun) in begun.into_iter().enumerate() {
        let own = begun.lane.users;
        let next = by_start.get(&begun.end).into_iter().flatten().copied();
        begun.lane.successors =
            next.filter(|&next| next != place as u32 && shares_users(next, own)).collect();
        begun.lane.beside = [0, 1].map(|side| {
            // The left bound of this lane is the right one of the lane to its left.
            let there = by_bound[1 - side].get(&begun.bounds[side]).copied();
            there.filter(|&there| begun.may_cross[side] && shares_users(there, own))
        });
        lanes.push(begun.lane);
    }
    lanes
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn near(point: &[f64; 2]) -> [f32; 2] {
    point.map(|x| x as f32)
}

impl Tags<'_> {
    /// Whether a tag says yes; none where it is not there.
    pub(crate) fn yes(self, key: &str) -> Result<Option<bool>, String> {
        match self.get(key) {
            None => Ok(None),
            Some("yes" | "true" | "1") => Ok(Some(true)),
            Some("no" | "false" | "0") => Ok(Some(false)),
            Some(other) => Err(format!("{key} = \"{}\": expected yes or no", shortened(other))),
        }
    }
}
