//! A tick as Foxglove's messages, in protobuf.
//!
//! The [`schemas`] are Foxglove's own descriptors; the numbers of the fields below come from them.

use perfetto::Message;
use scene::ContextMap;
use wire::tick_view::{AgentView, ForecastView, Point};
use wire::{AgentType, Cause, WorldOrigin, vocabulary};

use crate::autoware::{EGO, MAP, Tick, probable_paths, size_m};
use crate::markers;

/// Descriptors of Foxglove's messages.
pub mod schemas {
    /// `foxglove.SceneUpdate`.
    pub const SCENE_UPDATE: &[u8] = include_bytes!("foxglove_schemas/SceneUpdate.bin");
    /// `foxglove.FrameTransforms`.
    pub const FRAME_TRANSFORMS: &[u8] = include_bytes!("foxglove_schemas/FrameTransforms.bin");
    /// `foxglove.Grid`.
    pub const GRID: &[u8] = include_bytes!("foxglove_schemas/Grid.bin");
    /// `foxglove.Log`.
    pub const LOG: &[u8] = include_bytes!("foxglove_schemas/Log.bin");
}

/// `SceneEntityDeletion.type`: all entities of the topic.
const DELETE_ALL: u64 = 1;
/// Height of the lines above the ground.
const LINES_Z_M: f64 = 0.05;
/// Thickness of the lines, in pixels.
const LINE_PX: f64 = 3.0;

/// A color: red, green, blue and opacity.
type Color = [f64; 4];

/// The color of a forecast's cause on a dark ground; grey without a forecast.
#[must_use]
pub fn color(forecast: Option<&ForecastView>) -> Color {
    let look = forecast.and_then(|forecast| vocabulary::look(forecast.cause));
    let [red, green, blue] = look.map_or(vocabulary::UNKNOWN[1], |look| look.dark);
    let [red, green, blue] = [red, green, blue].map(|value| f64::from(value) / 255.0);
    [red, green, blue, 1.0]
}

fn time(message: &mut Message<'_>, field: u32, ns: i64) {
    message.message(field, |time| {
        // Protobuf has negative numbers as 64-bit two's complement.
        time.number(1, ns.div_euclid(1_000_000_000) as u64);
        time.number(2, ns.rem_euclid(1_000_000_000) as u64);
    });
}

fn xyz(message: &mut Message<'_>, field: u32, values: [f64; 3]) {
    message.message(field, |xyz| (1..).zip(values).for_each(|(field, value)| xyz.double(field, value)));
}

fn rgba(message: &mut Message<'_>, field: u32, color: Color) {
    message.message(field, |rgba| (1..).zip(color).for_each(|(field, value)| rgba.double(field, value)));
}

fn rotation(message: &mut Message<'_>, field: u32, heading_rad: f32) {
    let half = f64::from(heading_rad) / 2.0;
    message.message(field, |rotation| {
        rotation.double(3, half.sin());
        rotation.double(4, half.cos());
    });
}

fn pose(message: &mut Message<'_>, field: u32, [x, y]: [f64; 2], z_m: f64, heading_rad: f32) {
    message.message(field, |pose| {
        xyz(pose, 1, [x, y, z_m]);
        rotation(pose, 2, heading_rad);
    });
}

/// A `foxglove.SceneUpdate` that replaces the previous one: of each agent a box, its most probable paths, its
/// history and a label, colored by the cause of its forecast.
#[must_use]
pub fn scene_update(view: &Tick<'_>, paths_max: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut scene = Message::new(&mut bytes);
    scene.message(1, |deletion| {
        time(deletion, 1, view.stamp_ns);
        deletion.number(2, DELETE_ALL);
    });
    for agent in &view.agents {
        scene.message(2, |entity| {
            time(entity, 1, view.stamp_ns);
            entity.text(2, MAP);
            entity.text(3, &agent.known_as().to_string());
            for (key, value) in metadata(agent) {
                entity.message(6, |pair| {
                    pair.text(1, key);
                    pair.text(2, &value);
                });
            }
            shape(entity, view, agent);
            lines(entity, view, agent, paths_max);
            label(entity, view, agent);
        });
    }
    bytes
}

fn metadata(agent: &AgentView) -> Vec<(&'static str, String)> {
    let [vx_mps, vy_mps] = agent.velocity_mps;
    let mut pairs = vec![
        ("type", agent.agent_type.name().to_owned()),
        ("speed_mps", format!("{:.2}", vx_mps.hypot(vy_mps))),
        ("track", agent.id.to_string()),
    ];
    if let Some(forecast) = &agent.forecast {
        pairs.push(("quality", forecast.quality.name().to_owned()));
        pairs.push(("cause", Cause::name_of(forecast.cause).into_owned()));
        pairs.push(("age_ms", (forecast.age_ns / 1_000_000).to_string()));
    }
    pairs
}

fn shape(entity: &mut Message<'_>, view: &Tick<'_>, agent: &AgentView) {
    let size_m = size_m(agent).map(f64::from);
    let [red, green, blue, _] = color(agent.forecast.as_ref());
    // Pedestrians are cylinders.
    let field = if agent.agent_type == AgentType::Pedestrian { 10 } else { 8 };
    entity.message(field, |shape| {
        pose(shape, 1, view.origin.own_m(agent.position_m), size_m[2] / 2.0, agent.heading_rad);
        xyz(shape, 2, size_m);
        if field == 10 {
            shape.double(3, 1.0);
            shape.double(4, 1.0);
            rgba(shape, 5, [red, green, blue, 0.6]);
        } else {
            rgba(shape, 3, [red, green, blue, 0.6]);
        }
    });
}

/// The paths, the more probable the more opaque, and the history in grey.
fn lines(entity: &mut Message<'_>, view: &Tick<'_>, agent: &AgentView, paths_max: usize) {
    let strip = |entity: &mut Message<'_>, points: &mut dyn Iterator<Item = Point>, color| {
        entity.message(11, |line| {
            line.message(2, |pose| rotation(pose, 2, 0.0));
            line.double(3, LINE_PX);
            line.number(4, 1);
            points.for_each(|point| {
                let [x, y] = view.origin.own_m(point);
                xyz(line, 5, [x, y, LINES_Z_M]);
            });
            rgba(line, 6, color);
        });
    };
    let present = std::iter::once(agent.position_m);
    if let Some(forecast) = &agent.forecast {
        let paths = probable_paths(forecast, paths_max);
        let most = paths.first().map_or(1.0, |(_, probability)| probability.max(f32::MIN_POSITIVE));
        let [red, green, blue, _] = color(Some(forecast));
        for (points, probability) in paths {
            let opacity = 0.25 + 0.75 * f64::from(probability / most);
            let mut points = present.clone().chain(points.iter().copied());
            strip(entity, &mut points, [red, green, blue, opacity]);
        }
    }
    let mut past = agent.history.iter().flatten().copied().chain(present);
    strip(entity, &mut past, color(None));
}

fn label(entity: &mut Message<'_>, view: &Tick<'_>, agent: &AgentView) {
    entity.message(13, |label| {
        pose(label, 1, view.origin.own_m(agent.position_m), f64::from(size_m(agent)[2]) + 0.5, 0.0);
        label.number(2, 1);
        label.double(3, 12.0);
        label.number(4, 1);
        rgba(label, 5, [1.0; 4]);
        label.text(6, &markers::label(agent));
    });
}

/// A `foxglove.FrameTransforms` with the ego vehicle's pose; `None` if it is unknown.
#[must_use]
pub fn frame_transforms(view: &Tick<'_>) -> Option<Vec<u8>> {
    let (position_m, heading_rad) = view.ego?;
    let [x, y] = view.origin.own_m(position_m);
    let mut bytes = Vec::new();
    Message::new(&mut bytes).message(1, |transform| {
        time(transform, 1, view.stamp_ns);
        transform.text(2, MAP);
        transform.text(3, EGO);
        xyz(transform, 4, [x, y, 0.0]);
        rotation(transform, 5, heading_rad);
    });
    Some(bytes)
}

/// The fields of a cell of [`grid`], each a `float32`: visits as the network sees them, ln(1 + B / B̄), and
/// the mean velocity.
const CELL_FIELDS: [&str; 3] = ["visits", "vx_mps", "vy_mps"];
/// `PackedElementField.NumericType` of `float32`.
const FLOAT32: u64 = 7;

/// A `foxglove.Grid` of a context map.
#[must_use]
pub fn grid(map: &ContextMap, origin: WorldOrigin, stamp_ns: i64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut grid = Message::new(&mut bytes);
    let cell_bytes = 4 * CELL_FIELDS.len();
    time(&mut grid, 1, stamp_ns);
    grid.text(2, MAP);
    pose(&mut grid, 3, origin.own_m(map.origin_m()), 0.0, 0.0);
    grid.fixed32(4, map.cols() as u32);
    // Cells have 1 m.
    grid.message(5, |size| (1..=2).for_each(|field| size.double(field, 1.0)));
    grid.fixed32(6, (map.cols() * cell_bytes) as u32);
    grid.fixed32(7, cell_bytes as u32);
    for (place, name) in CELL_FIELDS.into_iter().enumerate() {
        grid.message(8, |field| {
            field.text(1, name);
            field.fixed32(2, 4 * place as u32);
            field.number(3, FLOAT32);
        });
    }
    let cells = map.visits().zip(map.velocity_mps());
    let cells = cells.flat_map(|(visits, [vx_mps, vy_mps])| [visits, vx_mps, vy_mps]);
    grid.data(9, &cells.flat_map(f32::to_le_bytes).collect::<Vec<u8>>());
    bytes
}

/// Levels of `foxglove.Log`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// To find faults.
    Debug = 1,
    /// As planned.
    Info = 2,
    /// To look at.
    Warning = 3,
    /// A fault.
    Error = 4,
}

/// A `foxglove.Log` of `name` at a Unix time.
#[must_use]
pub fn log(unix_ns: i64, level: Level, name: &str, text: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut log = Message::new(&mut bytes);
    time(&mut log, 1, unix_ns);
    log.number(2, level as u64);
    log.text(3, text);
    log.text(4, name);
    bytes
}
