//! The panel of a scene.

use metrics::Point;
use scene::{AgentType, ContextMap};

use super::agent::{REGION_OPACITY, Sketch};
use super::content::{LABEL_SIZE, SceneOptions};
use crate::canvas::{Align, Canvas, Frame, Stroke, Type};
use crate::colour::{GREY, INK, WHITE};
use crate::ground;
use crate::path::Path;
use crate::text::Face;
use crate::view::View;

/// Draws a scene into a frame: the ground, then layer by layer, so that no agent's mask hides another's line.
pub fn draw(
    canvas: &mut Canvas,
    frame: Frame,
    (map, lanes): (Option<&ContextMap>, &[Vec<Point>]),
    sketches: &[Sketch<'_>],
    options: &SceneOptions,
) {
    let has_forecasts = sketches.iter().any(|sketch| sketch.agent.forecast.is_some());
    let matters = |sketch: &&Sketch<'_>| !has_forecasts || sketch.agent.forecast.is_some();
    let shown = || sketches.iter().filter(matters);
    let is_vehicle = |sketch: &Sketch<'_>| sketch.agent.agent_type == AgentType::Vehicle;
    let usual_m = if shown().any(is_vehicle) { 30.0 } else { 12.0 };
    let extent_min_m = options.extent_min_m.unwrap_or(usual_m);
    if let Some(view) = View::of(shown().flat_map(Sketch::places), frame, extent_min_m) {
        canvas.clipped(frame, |canvas| {
            if let Some(map) = map {
                ground::draw_density(canvas, &view, map);
                if options.velocity {
                    ground::draw_velocity(canvas, &view, map);
                }
            }
            lanes.iter().for_each(|line| ground::draw_line(canvas, &view, line));
            for (number, opacity) in REGION_OPACITY.into_iter().enumerate() {
                let draw =
                    |sketch: &Sketch<'_>, canvas: &mut Canvas| sketch.draw_region(number, canvas, &view);
                canvas.faint(opacity, |canvas| sketches.iter().for_each(|sketch| draw(sketch, canvas)));
            }
            sketches.iter().for_each(|sketch| sketch.draw_modes(canvas, &view));
            sketches.iter().for_each(|sketch| sketch.draw_lines(canvas, &view));
            sketches.iter().for_each(|sketch| sketch.draw_body(canvas, &view));
            sketches.iter().for_each(|sketch| sketch.draw_ends(canvas, &view));
            if options.identities {
                sketches.iter().for_each(|sketch| label(canvas, &view, sketch));
            }
            draw_scale_bar(canvas, &view);
        });
    }
    canvas.stroke_frame(frame, &Stroke::solid(GREY, 0.5));
}

fn label(canvas: &mut Canvas, view: &View, sketch: &Sketch<'_>) {
    let [x, y] = view.spot(sketch.agent.position_m.map(f64::from));
    let look = Type { size: 5.5, face: Face::Regular, colour: INK, align: Align::Left };
    canvas.text([x + 3.5, y - 3.5], look, &sketch.agent.known_as().to_string());
}

/// Draws a scale bar of a round length in the lower left corner.
pub fn draw_scale_bar(canvas: &mut Canvas, view: &View) {
    let length_m = view.round_length_m();
    let length = length_m * view.scale();
    let (left, baseline) = (view.frame.corner[0] + 7.0, view.frame.bottom() - 7.0);
    let words = format!("{length_m} m");
    let plate = Frame { corner: [left - 3.5, baseline - 11.5], size: [length.max(18.0) + 7.0, 15.0] };
    let look = Type { size: LABEL_SIZE - 0.5, face: Face::Regular, colour: INK, align: Align::Middle };
    canvas.faint(0.8, |canvas| canvas.fill_frame(plate, WHITE));
    let middle = plate.centre_x();
    let (from, to) = (middle - length / 2.0, middle + length / 2.0);
    let mut bar = Path::line([[from, baseline], [to, baseline]]);
    for end in [from, to] {
        bar.add_line([[end, baseline - 1.8], [end, baseline + 1.8]]);
    }
    canvas.stroke(&bar, &Stroke::solid(INK, 0.8));
    canvas.text([middle, baseline - 3.6], look, &words);
}
