//! The pages that show a run in a browser: the live view, and the report as one file.
//!
//! Both pages draw scenes with the same script, from the published tracks and forecasts
//! ([`wire::tick_view::TickView`]). A page is one file: styles, scripts and data are inside, and it requests
//! nothing from any other server.

use std::collections::BTreeMap;

use wire::vocabulary::{LOOKS, Look, Rgb, UNKNOWN};
use wire::{AGENT_TYPES, AgentType, EXPERTS_MAX, Expert, Quality};

mod foresight;
pub mod http;
mod live;
mod report;
mod scene;

pub use foresight::{Conflict, Foreseen, Foresight};
pub use live::{Live, WRITE_LIMIT, is_direct};
pub use report::{PAGE_BYTES, RunPage, html, options_of};
pub use scene::{MODES_DRAWN, Pairing, Scene};

const STYLE: &str = include_str!("../assets/page.css");
/// The scripts of both pages, in the order in which they depend on each other.
const SCRIPTS: [&str; 7] = [
    include_str!("../assets/words.js"),
    include_str!("../assets/packed.js"),
    include_str!("../assets/regions.js"),
    include_str!("../assets/view.js"),
    include_str!("../assets/scene.js"),
    include_str!("../assets/charts.js"),
    include_str!("../assets/graph.js"),
];

/// Puts styles and scripts into a page.
fn page(html: &str, scripts: &[&str]) -> String {
    let [colors, names] = vocabulary();
    let scripts = std::iter::once(names.as_str()).chain(SCRIPTS).chain(scripts.iter().copied());
    let scripts: String = scripts.map(|script| format!("<script>\n{script}</script>\n")).collect();
    html.replacen("{{style}}", &(colors + STYLE), 1).replacen("{{scripts}}", &scripts, 1)
}

/// The names of numbers and the looks of causes, as colours of both themes and as constants of the scripts.
fn vocabulary() -> [String; 2] {
    let hex = |[red, green, blue]: Rgb| format!("#{red:02x}{green:02x}{blue:02x}");
    let theme = |selector: &str, unknown: Rgb, color: fn(&Look) -> Rgb| {
        let variable = |look: &Look| format!(" --cause-{}: {};", look.cause.name(), hex(color(look)));
        let causes: String = LOOKS.iter().map(variable).collect();
        format!("{selector} {{ --unknown: {};{causes} }}\n", hex(unknown))
    };
    let colors = theme(":root", UNKNOWN[0], |look| look.light)
        + &theme(":root[data-theme=\"dark\"]", UNKNOWN[1], |look| look.dark);
    let looks = LOOKS.map(|look| {
        serde_json::json!({
            "cause": look.cause.name(), "words": look.words, "explanation": look.explanation,
            "normal": look.is_normal, "dash": look.dash, "shape": look.shape,
        })
    });
    let slots = Expert::ALL.iter().take(EXPERTS_MAX);
    let constants = serde_json::json!({
        "LOOKS": looks,
        "TYPES": AGENT_TYPES.map(AgentType::name),
        "QUALITIES": Quality::ALL.map(Quality::name),
        // By slot and type.
        "EXPERTS": slots.map(|expert| AGENT_TYPES.map(|of| expert.name_for(of))).collect::<Vec<_>>(),
        "PARTNERS": recorder::PARTNERS.into_iter().collect::<BTreeMap<_, _>>(),
        "STEADY": Expert::ConstantVelocity as u32,
        "EGO_CM": foresight::EGO_M.map(|size_m| size_m * 100.0),
    });
    let constants = constants.as_object().into_iter().flatten();
    [colors, constants.map(|(name, value)| format!("const {name} = {value};\n")).collect()]
}

/// The live page.
fn live_page() -> String {
    let scripts = [
        include_str!("../assets/kept.js"),
        include_str!("../assets/panels.js"),
        include_str!("../assets/live.js"),
    ];
    page(include_str!("../assets/live.html"), &scripts)
}

/// The bounds of lanes as JSON, in whole centimetres: the first value of an element is the type.
#[must_use]
pub fn lanes_json(map: &lanes::LaneMap) -> String {
    let lanes = map.lanes().iter().flat_map(|lane| lane.bounds_m.iter());
    let flat = |bound: &Vec<[f32; 2]>| -> Vec<i64> {
        bound.iter().flatten().map(|value| (f64::from(*value) * 1e2).round() as i64).collect()
    };
    serde_json::to_string(&lanes.map(flat).collect::<Vec<_>>()).unwrap_or_default()
}
