//! Forecast scenes, one panel each.

mod agent;
mod check;
mod content;
mod legend;
mod panel;

use super::canvas::{Align, Canvas, Frame, Type};
use super::colour::{GREY, INK};
use super::error::PictureError;
use super::text::Face;
use agent::Sketch;
pub(super) use content::LABEL_SIZE;
pub use content::{AgentDrawing, SceneDrawing, SceneOptions};
use legend::Legend;
pub(super) use panel::draw_scale_bar;

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
