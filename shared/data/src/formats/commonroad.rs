//! CommonRoad scenarios, XML of version 2018b or 2020a: the recorded or simulated traffic of a scenario.
//!
//! A dynamic obstacle has a type, a shape, an initial state and a trajectory. A static obstacle has an
//! initial state only, and stays in it in every frame. A state contains its time in steps of the root's
//! `timeStepSize` and a position (metres). It usually also contains an orientation (radians) and a velocity
//! (m/s along the orientation). Each of them must be exact. 2018b writes `<obstacle>` with a `<role>`, 2020a
//! writes `<dynamicObstacle>` and `<staticObstacle>`.
//!
//! Cars, trucks, buses, taxis, motorcycles, priority and parked vehicles are vehicles. Bicycles are cyclists.
//! The states of trains, buildings, road boundaries and other obstacles are left out and counted, and so are
//! occupancies without states. A file that is cut off is read up to its last whole obstacle. The vehicle that a planner should drive (`planningProblem`) is not an agent.

use std::collections::BTreeSet;

use roxmltree::{Document, Node, ParsingOptions};
use wire::{AgentType, Detection, WorldOrigin, detection_flags};

use crate::input::need;
use crate::rows::{self, ALL_TYPES, Rows};
use crate::text::{self, Field, Line};
use crate::{Input, LeftOut, ReadError, Recording, Role, damage, sweeps};

/// Size of the largest file that is read. In memory it takes several times its size.
const XML_BYTES_MAX: u64 = 256 << 20;
/// Maximum number of elements, texts and comments of a file.
const XML_NODES_MAX: u32 = 16_000_000;
/// Shortest and longest step, s.
const STEP_S: std::ops::RangeInclusive<f64> = 0.001..=10.0;
/// The end of the root.
const END: &str = "</commonRoad>";
/// Maximum number of lines that are searched for the root.
const LINES_MAX: usize = 1_000;

/// The agent type of an obstacle, or its absence.
enum Kind {
    Agent(AgentType),
    /// Not a road user, or not a known one.
    Other,
}

/// Largest difference between the numbers of equal states: those of different rounding.
const STATE_TOLERANCE: f32 = 2e-3;

/// Whether a file that begins with `<` is of this format, by its first lines.
pub(crate) fn is_root_among<'a>(lines: impl Iterator<Item = Result<Line<'a>, ReadError>>) -> bool {
    lines.take(LINES_MAX).map_while(Result::ok).any(|line| line.text.contains("<commonRoad"))
}

/// Reads a scenario.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    if input.bytes.len() as u64 > XML_BYTES_MAX {
        return Err(ReadError::too_large(&input.path, input.bytes.len() as u64, XML_BYTES_MAX));
    }
    // Refuses bytes that are not text, and names their line.
    let last = text::lines(input).try_fold(None, |_, line| line.map(|line| Some(line.number)))?;
    let last = last.ok_or_else(|| ReadError::Empty { path: input.path.clone() })?;
    let content = str::from_utf8(&input.bytes).unwrap_or_default();
    let options = ParsingOptions { nodes_limit: XML_NODES_MAX, ..ParsingOptions::default() };
    let cut = cut_at(content);
    let closed = cut.map(|at| [&content[..at], END].concat());
    let content = closed.as_deref().unwrap_or(content);
    let document = Document::parse_with_options(content, options).map_err(|error| {
        let [line, column] = match error {
            roxmltree::Error::UnclosedRootNode | roxmltree::Error::UnexpectedEndOfStream => [last, 1],
            _ => [error.pos().row, error.pos().col].map(|place| place as usize),
        };
        ReadError::Syntax { path: input.path.clone(), line, column, problem: format!("not XML: {error}") }
    })?;
    let source = Source::new(input, content);
    let root = document.root_element();
    if root.tag_name().name() != "commonRoad" {
        return Err(source.name(root, "root").error("expected commonRoad"));
    }
    let step = source.attribute(root, "timeStepSize")?;
    let step_ns = (step.number_in(STEP_S)? * 1e9).round() as i64;

    let mut reading =
        Reading { source: &source, step_ns, rows: Rows::default(), stays: Vec::new(), other: Vec::new() };
    for obstacle in root.children().filter(Node::is_element) {
        reading.obstacle(obstacle)?;
    }
    let mut recording = reading.recording(input)?;
    if let Some(at) = cut {
        let (path, len) = (&input.path, input.bytes.len());
        let sentence =
            format!("the file {path} is cut off at byte {at} of {len}: the agents that followed are missing");
        recording.findings.push(damage::doubt("cut_off", sentence));
    }
    Ok(recording)
}

/// The byte behind the last whole obstacle, if the file ends before its root does.
fn cut_at(content: &str) -> Option<usize> {
    let tail = &content.as_bytes()[content.len().saturating_sub(2 * END.len())..];
    if content.contains(END) || tail.windows(END.len()).any(|end| end.eq_ignore_ascii_case(END.as_bytes())) {
        return None;
    }
    let after = |end: &str| content.rfind(end).map(|at| at + end.len());
    ["</dynamicObstacle>", "</staticObstacle>", "</obstacle>"].into_iter().filter_map(after).max()
}

/// The content that was read so far.
struct Reading<'a, 's> {
    source: &'s Source<'a>,
    step_ns: i64,
    rows: Rows<'a>,
    /// Static agents, with the lines of their states.
    stays: Vec<(Line<'a>, i64, Detection)>,
    /// Types without agents, and their states.
    other: Vec<LeftOut>,
}

/// Whether two states are at one place, with the same values of motion as far as both have them.
fn is_equal(a: &Detection, b: &Detection) -> bool {
    let near = |a: f32, b: f32| (a - b).abs() <= STATE_TOLERANCE;
    let both = |flag: u32| a.has(flag) && b.has(flag);
    near(a.x_m, b.x_m)
        && near(a.y_m, b.y_m)
        && (!both(detection_flags::HAS_HEADING) || near(a.heading_rad, b.heading_rad))
        && (!both(detection_flags::HAS_SPEED) || near(a.speed_mps, b.speed_mps))
}

impl<'a> Reading<'a, '_> {
    fn obstacle(&mut self, obstacle: Node<'a, 'a>) -> Result<(), ReadError> {
        let source = self.source;
        let is_static = match obstacle.tag_name().name() {
            "dynamicObstacle" => false,
            "staticObstacle" => true,
            "obstacle" => {
                let role = source.text(source.child(obstacle, "role")?, "role");
                match role.text {
                    "dynamic" => false,
                    "static" => true,
                    _ => return Err(role.error("expected dynamic or static")),
                }
            }
            "environmentObstacle" | "phantomObstacle" => {
                self.leave_out(obstacle.tag_name().name(), 1);
                return Ok(());
            }
            _ => return Ok(()),
        };
        let kind = source.text(source.child(obstacle, "type")?, "type");
        let trajectory = obstacle.children().filter(|node| node.has_tag_name("trajectory"));
        let states = trajectory.flat_map(|node| node.children()).filter(|node| node.has_tag_name("state"));
        let initial = source.child(obstacle, "initialState")?;
        let agent_type = match agent_type(kind)? {
            Kind::Agent(agent_type) => agent_type,
            Kind::Other => {
                self.leave_out(kind.text, 1 + states.count());
                return Ok(());
            }
        };
        let id = source.attribute(obstacle, "id")?.id_below(u64::MAX)?;
        let usual = Detection { id, ..self.sized(obstacle, rows::identified(agent_type, [0.0; 2], id))? };
        let first = self.state(initial, usual)?;
        for (place, state) in std::iter::once(initial).chain(states).enumerate() {
            let (stamp_ns, detection) = self.state(state, usual)?;
            // A trajectory may repeat the initial state.
            if place == 1 && stamp_ns == first.0 && is_equal(&detection, &first.1) {
                continue;
            }
            let line = source.line(state.range().start);
            match is_static {
                true => self.stays.push((line, stamp_ns, detection)),
                false => self.rows.push(&line, stamp_ns, detection)?,
            }
        }
        Ok(())
    }

    /// Returns the detection with the extent of the obstacle's shape, if the shape has one.
    fn sized(&self, obstacle: Node<'a, 'a>, detection: Detection) -> Result<Detection, ReadError> {
        let shape = obstacle.children().find(|node| node.has_tag_name("shape"));
        let form = shape.and_then(|shape| shape.first_element_child());
        let [length_m, width_m] = match form.map(|form| (form, form.tag_name().name())) {
            Some((form, "rectangle")) => [
                self.source.text(self.source.child(form, "length")?, "length").extent_m()?,
                self.source.text(self.source.child(form, "width")?, "width").extent_m()?,
            ],
            Some((form, "circle")) => {
                let radius = self.source.text(self.source.child(form, "radius")?, "radius");
                [2.0 * radius.number_in(0.0..=50.0)? as f32; 2]
            }
            _ => return Ok(detection),
        };
        Ok(Detection { length_m, width_m, flags: detection.flags | detection_flags::HAS_SIZE, ..detection })
    }

    fn state(&self, state: Node<'a, 'a>, usual: Detection) -> Result<(i64, Detection), ReadError> {
        let source = self.source;
        let time = self.exact(state, "time")?.ok_or_else(|| source.missing(state, "time"))?;
        let stamp_ns =
            time.frame()?.checked_mul(self.step_ns).filter(|stamp_ns| *stamp_ns <= text::STAMP_MAX_NS);
        let stamp_ns = stamp_ns.ok_or_else(|| time.error("too many steps"))?;
        let point = source.child(source.child(state, "position")?, "point")?;
        let x = source.text(source.child(point, "x")?, "x");
        let y = source.text(source.child(point, "y")?, "y");
        let [x_m, y_m] = text::position_m([x, y])?;
        let mut detection = Detection { x_m, y_m, ..usual };
        if let Some(orientation) = self.exact(state, "orientation")? {
            detection.heading_rad = orientation.angle_rad()?;
            detection.flags |= detection_flags::HAS_HEADING;
        }
        if let Some(velocity) = self.exact(state, "velocity")? {
            detection.speed_mps = velocity.speed_mps()?;
            detection.flags |= detection_flags::HAS_SPEED;
        }
        Ok((stamp_ns, detection))
    }

    /// The exact value of a part of a state; `None` if the state does not have the part.
    fn exact(&self, state: Node<'a, 'a>, name: &'static str) -> Result<Option<Field<'a>>, ReadError> {
        let part = state.children().find(|node| node.has_tag_name(name));
        part.map(|part| Ok(self.source.text(self.source.child(part, "exact")?, name))).transpose()
    }

    fn leave_out(&mut self, reason: &str, row_count: usize) {
        match self.other.iter_mut().find(|other| other.reason == reason) {
            Some(other) => other.row_count += row_count,
            None => self.other.push(LeftOut { reason: reason.to_owned(), row_count }),
        }
    }

    /// The recording, with static agents in every frame.
    fn recording(mut self, input: &Input) -> Result<Recording, ReadError> {
        let mut stamps: BTreeSet<i64> = self.rows.stamps().collect();
        if stamps.is_empty() {
            stamps.extend(self.stays.iter().map(|(_, stamp_ns, _)| *stamp_ns));
        }
        for stamp_ns in stamps {
            for (line, _, detection) in &self.stays {
                self.rows.push(line, stamp_ns, *detection)?;
            }
        }
        let frames = sweeps::numbered(&self.rows.sorted(input)?, ALL_TYPES);
        Ok(Recording {
            interval_ns: self.step_ns as u64,
            has_identities: true,
            frames,
            left_out: self.other,
            ..Recording::default()
        })
    }
}

fn agent_type(kind: Field<'_>) -> Result<Kind, ReadError> {
    match kind.text {
        "car" | "truck" | "bus" | "taxi" | "motorcycle" | "priorityVehicle" | "parkedVehicle" => {
            Ok(Kind::Agent(AgentType::Vehicle))
        }
        "bicycle" => Ok(Kind::Agent(AgentType::Cyclist)),
        "pedestrian" => Ok(Kind::Agent(AgentType::Pedestrian)),
        "unknown" | "train" | "constructionZone" | "roadBoundary" | "building" | "pillar"
        | "median_strip" | "medianStrip" => Ok(Kind::Other),
        _ => Err(kind.error("no obstacle type of CommonRoad 2018b or 2020a")),
    }
}

/// The text of a file, with the positions of its lines.
struct Source<'a> {
    path: &'a str,
    origin: WorldOrigin,
    text: &'a str,
    line_starts: Vec<usize>,
}

impl<'a> Source<'a> {
    fn new(input: &'a Input, text: &'a str) -> Self {
        let after_breaks = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at + 1);
        let line_starts = std::iter::once(0).chain(after_breaks).collect();
        Self { path: &input.path, origin: input.origin, text, line_starts }
    }

    /// The line of a byte, without its text, because no error quotes it.
    fn line(&self, byte: usize) -> Line<'a> {
        let number = self.line_starts.partition_point(|start| *start <= byte);
        Line { path: self.path, number, text: "", origin: self.origin }
    }

    fn field(&self, byte: usize, name: &'static str, text: &'a str) -> Field<'a> {
        let line = self.line(byte);
        let start = self.line_starts.get(line.number.saturating_sub(1)).copied().unwrap_or(0);
        line.field(name, byte - start + 1, text)
    }

    /// The text of an element without children.
    fn text(&self, node: Node<'a, 'a>, name: &'static str) -> Field<'a> {
        let start = node.first_child().map_or(node.range().start, |child| child.range().start);
        let whole = node.text().unwrap_or("");
        let indent = whole.len() - whole.trim_start().len();
        self.field((start + indent).min(self.text.len()), name, whole.trim())
    }

    /// The name of an element as a value.
    fn name(&self, node: Node<'a, 'a>, name: &'static str) -> Field<'a> {
        self.field(node.range().start, name, node.tag_name().name())
    }

    fn child(&self, node: Node<'a, 'a>, name: &'static str) -> Result<Node<'a, 'a>, ReadError> {
        let child = node.children().find(|child| child.has_tag_name(name));
        child.ok_or_else(|| self.missing(node, name))
    }

    fn missing(&self, node: Node<'a, 'a>, name: &'static str) -> ReadError {
        self.name(node, "element").error(format!("needs {name}"))
    }

    fn attribute(&self, node: Node<'a, 'a>, name: &'static str) -> Result<Field<'a>, ReadError> {
        let value = node.attribute_node(name).ok_or_else(|| self.missing(node, name))?;
        Ok(self.field(value.range_value().start, name, value.value()))
    }
}
