//! The pages that show a run in a browser: the live view, and the report as one file.
//!
//! Both pages draw scenes with the same script, from the published tracks and forecasts
//! ([`wire::tick_view::TickView`]). A page is one file: styles, scripts and data are inside, and it requests
//! nothing from any other server.

use wire::vocabulary::{LOOKS, Look, Rgb, UNKNOWN};

mod foresight;
pub mod http;
mod live;
mod report;
mod scene;

pub use foresight::{Conflict, Foreseen, Foresight};
pub use live::{Live, WRITE_LIMIT, is_direct};
pub use report::{PAGE_BYTES, RunPage, html};
pub use scene::{MODES_DRAWN, Pairing, Scene};

const STYLE: &str = include_str!("../assets/page.css");
const PACKED: &str = include_str!("../assets/packed.js");
const SCENE: &str = include_str!("../assets/scene.js");
const CHARTS: &str = include_str!("../assets/charts.js");
const GRAPH: &str = include_str!("../assets/graph.js");

/// Puts styles and scripts into a page.
fn page(html: &str, scripts: &[&str]) -> String {
    let [colors, looks] = vocabulary();
    let scripts = [looks.as_str(), PACKED, SCENE, CHARTS, GRAPH].into_iter().chain(scripts.iter().copied());
    let scripts: String = scripts.map(|script| format!("<script>\n{script}</script>\n")).collect();
    html.replacen("{{style}}", &(colors + STYLE), 1).replacen("{{scripts}}", &scripts, 1)
}

/// The vocabulary of causes as colours of both themes, and as a constant of the scripts.
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
    let ego_cm = foresight::EGO_M.map(|size_m| size_m * 100.0);
    let looks = serde_json::Value::from(looks.to_vec());
    [colors, format!("const LOOKS = {looks};\nconst EGO_CM = {ego_cm:?};\n")]
}

/// The live page.
fn live_page() -> String {
    page(include_str!("../assets/live.html"), &[include_str!("../assets/live.js")])
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
