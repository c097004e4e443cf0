//! A whole recording: the paths of all agents and of the sensor, and the map.

use std::collections::HashSet;

use metrics::Point;
use scene::AgentType;

use super::canvas::{Align, Canvas, Frame, Stroke, Type};
use super::colour::{BLUE, Colour, GREY, INK, ORANGE, VERMILION};
use super::error::{PictureError, within};
use super::ground;
use super::path::{Path, Spot};
use super::scene::draw_scale_bar;
use super::text::Face;
use super::view::View;

/// Edge of the sheet, pt.
const EDGE: f64 = 3.0;
/// Height of the title, of the note and of a legend row, pt.
const ROW: f64 = 12.0;
/// Width of a legend entry, pt.
const ENTRY: f64 = 96.0;
/// Smallest extent of the world, m.
const EXTENT_MIN_M: f64 = 20.0;
/// Points closer than this on paper count as one, pt.
const NEAR: f64 = 0.6;

/// A recording to draw.
#[derive(Clone, Debug, Default)]
pub struct Overview {
    /// The name of the recording.
    pub title: String,
    /// Further text, in smaller type.
    pub note: String,
    /// Lines on the ground, such as the bounds of lanes.
    pub lines: Vec<Vec<Point>>,
    /// Paths of agents without a gap. A path of one point is drawn as a dot.
    pub ways: Vec<(AgentType, Vec<Point>)>,
    /// Paths of the sensor.
    pub ego: Vec<Vec<Point>>,
}

const fn colour(agent_type: AgentType) -> Colour {
    match agent_type {
        AgentType::Vehicle => BLUE,
        AgentType::Cyclist => ORANGE,
        AgentType::Pedestrian => VERMILION,
    }
}

/// Draws a recording as one picture of the given width, pt, with north up.
///
/// # Errors
/// [`PictureError`] if there is nothing to draw, or if the width is out of range.
pub fn overview(drawing: &Overview, width: f64) -> Result<String, PictureError> {
    within("the width", width, 100.0, 2_000.0)?;
    let side = width - 2.0 * EDGE;
    let frame = Frame { corner: [EDGE, EDGE + 2.0 * ROW], size: [side, 0.75 * side] };
    let view = view(drawing, frame).ok_or(PictureError::Empty)?;
    let mut canvas = Canvas::new([width, frame.bottom() + ROW + EDGE]);
    let title = Type { size: 9.0, face: Face::Medium, colour: INK, align: Align::Left };
    canvas.fitted_text([EDGE, EDGE + 0.75 * ROW], title, &drawing.title, side);
    let note = Type { size: 7.0, face: Face::Regular, colour: GREY, align: Align::Left };
    canvas.fitted_text([EDGE, EDGE + 1.7 * ROW], note, &drawing.note, side);
    canvas.clipped(frame, |canvas| {
        drawing.lines.iter().for_each(|line| ground::draw_line(canvas, &view, line));
        draw_ways(canvas, &view, &drawing.ways);
        for way in &drawing.ego {
            match thinned(&view, way)[..] {
                [spot] => canvas.fill(&Path::disc(spot, 1.8), INK, 1.0),
                ref spots => {
                    let line = Path::line(spots.iter().copied());
                    canvas.stroke(&line, &Stroke::solid(INK, 1.0).dashed(&[2.5, 1.5]));
                }
            }
        }
        draw_scale_bar(canvas, &view);
    });
    canvas.stroke_frame(frame, &Stroke::solid(GREY, 0.5));
    draw_legend(&mut canvas, drawing, frame.bottom() + 0.75 * ROW);
    Ok(canvas.finish(&drawing.title))
}

/// The view of all paths. Lanes outside it are clipped. If no lane is in the view, the view covers all lanes.
fn view(drawing: &Overview, frame: Frame) -> Option<View> {
    let ways = drawing.ways.iter().map(|(_, way)| way).chain(&drawing.ego);
    let [ways, lines] = [ways.collect::<Vec<_>>(), drawing.lines.iter().collect()].map(|lines| {
        let places = lines.into_iter().flatten().map(|point| point.map(f64::from));
        places.filter(|place| place.iter().all(|x| x.is_finite())).collect::<Vec<_>>()
    });
    let is_seen = |view: &View| {
        let (low, high) = view.corners();
        let is_inside = |place: &[f64; 2]| (0..2).all(|axis| (low[axis]..high[axis]).contains(&place[axis]));
        lines.is_empty() || lines.iter().any(is_inside)
    };
    let all = || View::of(ways.iter().chain(&lines).copied(), frame, EXTENT_MIN_M);
    View::of(ways.iter().copied(), frame, EXTENT_MIN_M).filter(is_seen).or_else(all)
}

fn draw_ways(canvas: &mut Canvas, view: &View, ways: &[(AgentType, Vec<Point>)]) {
    let mut dots: HashSet<(AgentType, [i64; 2])> = HashSet::new();
    for (agent_type, way) in ways {
        let spots = thinned(view, way);
        match spots[..] {
            [] => {}
            [spot] => {
                if dots.insert((*agent_type, spot.map(|x| (x / NEAR) as i64))) {
                    canvas.fill(&Path::disc(spot, 0.7), colour(*agent_type), 0.7);
                }
            }
            [.., last] => {
                canvas.stroke(&Path::line(spots), &Stroke::solid(colour(*agent_type), 0.6).faint(0.7));
                canvas.fill(&Path::disc(last, 1.0), colour(*agent_type), 0.9);
            }
        }
    }
}

/// The spots of a path, without those that are indistinguishable on paper.
fn thinned(view: &View, way: &[Point]) -> Vec<Spot> {
    let mut spots: Vec<Spot> = Vec::new();
    for point in way {
        let spot = view.spot(point.map(f64::from));
        let near = |last: &Spot| (last[0] - spot[0]).hypot(last[1] - spot[1]) < NEAR;
        if !spots.last().is_some_and(near) {
            spots.push(spot);
        }
    }
    spots
}

fn draw_legend(canvas: &mut Canvas, drawing: &Overview, baseline: f64) {
    let types = [
        (AgentType::Vehicle, "vehicles"),
        (AgentType::Cyclist, "cyclists"),
        (AgentType::Pedestrian, "pedestrians"),
    ];
    let has = |agent_type| drawing.ways.iter().any(|(of_way, _)| *of_way == agent_type);
    let present = types.into_iter().filter(|(agent_type, _)| has(*agent_type));
    let entries = present.map(|(agent_type, name)| (Stroke::solid(colour(agent_type), 1.2), name));
    let ego = (!drawing.ego.is_empty()).then_some((Stroke::solid(INK, 1.0).dashed(&[2.5, 1.5]), "sensor"));
    let lines = (!drawing.lines.is_empty()).then_some((Stroke::solid(GREY, 0.5), "lanes"));
    let look = Type { size: 7.0, face: Face::Regular, colour: INK, align: Align::Left };
    for (place, (stroke, name)) in entries.chain(ego).chain(lines).enumerate() {
        let left = EDGE + place as f64 * ENTRY;
        canvas.stroke(&Path::line([[left, baseline - 2.3], [left + 12.0, baseline - 2.3]]), &stroke);
        canvas.text([left + 15.0, baseline], look, name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pedestrian walks 40 m past a sensor. A lane begins 10 m beside the pedestrian's path.
    fn drawing(lane_end_m: f32, ego: Vec<Point>) -> Overview {
        Overview {
            title: "walk".to_owned(),
            lines: vec![vec![[lane_end_m - 500.0, 10.0], [lane_end_m, 10.0]]],
            ways: vec![(AgentType::Pedestrian, (0..=40).map(|step| [step as f32, 0.0]).collect())],
            ego: vec![ego],
            ..Overview::default()
        }
    }

    #[test]
    fn a_large_map_does_not_make_the_ways_small() {
        let scale = |lane_end_m| overview(&drawing(lane_end_m, vec![[20.0, 0.0]]), 516.0).unwrap();
        assert!(scale(30.0).contains("aria-label=\"10 m\""), "the lane passes by");
        assert!(scale(-800.0).contains("aria-label=\"200 m\""), "a lane elsewhere is shown, too");
    }

    #[test]
    fn a_sensor_that_stands_is_a_dot() {
        let discs = |ego| {
            overview(&drawing(30.0, ego), 516.0)
                .unwrap()
                .matches(&format!("fill=\"{INK}\" fill-rule"))
                .count()
        };
        assert_eq!(discs(vec![[20.0, 0.0]; 9]), discs(vec![[20.0, 0.0], [20.0, 9.0]]) + 1);
    }
}
