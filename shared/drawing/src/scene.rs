//! Forecast scenes, one panel each.

mod agent;
mod check;
mod legend;
mod panel;

use metrics::Point;
use scene::ContextMap;
use wire::tick_view::AgentView;

use super::canvas::{Align, Canvas, Frame, Type};
use super::colour::{GREY, INK};
use super::error::PictureError;
use super::mask::Mask;
use super::text::Face;
use agent::Sketch;
use legend::Legend;
pub(super) use panel::draw_scale_bar;

/// A moment of a recording, with the forecasts made at that moment.
#[derive(Clone, Debug, Default)]
pub struct SceneDrawing<'a> {
    /// The title of the panel.
    pub title: String,
    /// Further text, in smaller type.
    pub note: String,
    /// The context map to draw beneath.
    pub map: Option<&'a ContextMap>,
    /// The bounds of lanes.
    pub lanes: Vec<Vec<Point>>,
    /// The agents. The panel is about the agents with a forecast.
    pub agents: Vec<AgentDrawing>,
}

/// An agent of a scene.
#[derive(Clone, Debug)]
pub struct AgentDrawing {
    /// The agent with its published forecast. Vehicles are drawn as boxes, all others as discs.
    pub agent: AgentView,
    /// Observed future positions, one per step.
    pub truth: Vec<Option<Point>>,
}

/// How scenes are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneOptions {
    /// Width of the picture, pt. A column of a two-column paper has about 252 pt, a page 516 pt.
    pub width: f64,
    /// Number of panels side by side.
    pub columns: usize,
    /// Height of a panel relative to its width.
    pub height_per_width: f64,
    /// Smallest extent of the world in a panel, m. The default is 30 m around vehicles and 12 m around
    /// others.
    pub extent_min_m: Option<f64>,
    /// The times that the mask covers.
    pub mask: Mask,
    /// Whether the map's mean velocities are drawn as arrows.
    pub velocity: bool,
    /// Whether agents are labelled with their identities.
    pub identities: bool,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            width: 516.0,
            columns: 2,
            height_per_width: 0.8,
            extent_min_m: None,
            mask: Mask::default(),
            velocity: false,
            identities: false,
        }
    }
}

/// Maximum number of panels in a picture.
const PANELS_MAX: usize = 64;
/// Edge of the sheet, pt.
const EDGE: f64 = 3.0;
/// Space between panels, pt.
const GAP: f64 = 9.0;
/// Height of the heading, and of titles and notes above a panel, pt.
const HEADING_HEIGHT: f64 = 14.0;
const TITLE_HEIGHT: f64 = 11.0;
const NOTE_HEIGHT: f64 = 9.0;
/// Font sizes, pt.
const HEADING_SIZE: f64 = 9.0;
const TITLE_SIZE: f64 = 8.0;
pub(super) const LABEL_SIZE: f64 = 7.0;

/// Draws scenes as one picture in reading order, with one heading and one legend.
///
/// # Errors
/// [`PictureError`] if there is no scene, an option or a number cannot be drawn, or the parts of a forecast
/// differ in length.
pub fn scenes(
    heading: &str,
    drawings: &[SceneDrawing<'_>],
    options: &SceneOptions,
) -> Result<String, PictureError> {
    check::options(options)?;
    check::panels(drawings, PANELS_MAX)?;
    let columns = options.columns.min(drawings.len());
    let panel_width = (options.width - 2.0 * EDGE - (columns - 1) as f64 * GAP) / columns as f64;
    let panel_height = panel_width * options.height_per_width;
    let has_notes = drawings.iter().any(|drawing| !drawing.note.is_empty());
    let head_height = TITLE_HEIGHT + if has_notes { NOTE_HEIGHT } else { 0.0 };
    let legend = Legend::of(drawings, options, options.width - 2.0 * EDGE);
    let rows = drawings.len().div_ceil(columns);
    let row_height = head_height + panel_height + GAP;
    let top = EDGE + if heading.is_empty() { 0.0 } else { HEADING_HEIGHT };
    let legend_top = top + rows as f64 * row_height;

    let mut canvas = Canvas::new([options.width, legend_top + legend.height() + EDGE]);
    let look = Type { size: HEADING_SIZE, face: Face::Medium, colour: INK, align: Align::Left };
    canvas.fitted_text([EDGE, EDGE + 0.7 * HEADING_HEIGHT], look, heading, options.width - 2.0 * EDGE);
    for (index, drawing) in drawings.iter().enumerate() {
        let corner = [
            EDGE + (index % columns) as f64 * (panel_width + GAP),
            top + (index / columns) as f64 * row_height,
        ];
        let letter = (drawings.len() > 1).then(|| letters(index));
        draw_head(&mut canvas, corner, panel_width, letter.as_deref(), drawing);
        let frame = Frame { corner: [corner[0], corner[1] + head_height], size: [panel_width, panel_height] };
        let sketches: Vec<Sketch<'_>> =
            drawing.agents.iter().map(|agent| Sketch::new(agent, options.mask)).collect();
        panel::draw(&mut canvas, frame, (drawing.map, &drawing.lanes), &sketches, options);
    }
    legend.draw(&mut canvas, [EDGE, legend_top]);
    let titles: Vec<&str> = drawings.iter().map(|drawing| drawing.title.as_str()).collect();
    Ok(canvas.finish(&format!("{heading}: {}", titles.join("; "))))
}

fn draw_head(
    canvas: &mut Canvas,
    [x, y]: [f64; 2],
    width: f64,
    letter: Option<&str>,
    drawing: &SceneDrawing<'_>,
) {
    let look = Type { size: TITLE_SIZE, face: Face::Medium, colour: INK, align: Align::Left };
    let baseline = y + 0.75 * TITLE_HEIGHT;
    let indent = letter.map_or(0.0, |letter| canvas.text([x, baseline], look, letter) + 3.0);
    canvas.fitted_text([x + indent, baseline], look, &drawing.title, width - indent);
    let look = Type { size: LABEL_SIZE, face: Face::Regular, colour: GREY, align: Align::Left };
    canvas.fitted_text([x, y + TITLE_HEIGHT + 0.72 * NOTE_HEIGHT], look, &drawing.note, width);
}

/// (a), (b) … (z), (aa) …
fn letters(index: usize) -> String {
    let letter = |number: usize| char::from(b'a' + (number % 26) as u8);
    match index.checked_sub(26) {
        None => format!("({})", letter(index)),
        Some(rest) => format!("({}{})", letter(rest / 26), letter(rest)),
    }
}
