//! The pages that show a run in a browser: the live view, and the report as one file.
//!
//! Both pages draw scenes with the same script, from the published tracks and forecasts
//! ([`wire::tick_view::TickView`]). A page is one file: styles, scripts and data are inside, and it requests
//! nothing from any other server.

pub mod http;
mod live;
mod report;
mod scene;

pub use live::{Live, WRITE_LIMIT};
pub use report::{PAGE_BYTES, RunPage, html};
pub use scene::{MODES_DRAWN, Pairing, Scene};

const STYLE: &str = include_str!("../assets/page.css");
const SCENE: &str = include_str!("../assets/scene.js");
const CHARTS: &str = include_str!("../assets/charts.js");

/// Puts styles and scripts into a page.
fn page(html: &str, scripts: &[&str]) -> String {
    let scripts: String = scripts.iter().map(|script| format!("<script>\n{script}</script>\n")).collect();
    html.replacen("{{style}}", STYLE, 1).replacen("{{scripts}}", &scripts, 1)
}

/// The live page.
fn live_page() -> String {
    page(include_str!("../assets/live.html"), &[SCENE, CHARTS, include_str!("../assets/live.js")])
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
