//! One agent under noise: its detections, its track, its forecast and its true motion.

use metrics::Point;

use super::canvas::{Align, Canvas, Frame, Stroke, Type};
use super::colour::{BLUE, GREEN, GREY, INK, ORANGE, VERMILION};
use super::error::{PictureError, within};
use super::path::{Path, Spot};
use super::scene::{LABEL_SIZE, draw_scale_bar};
use super::text::{self, Face};
use super::view::View;

/// Edge of the sheet, pt.
const EDGE: f64 = 3.0;
/// Height of the title, of the note and of the legend, pt.
const ROW: f64 = 12.0;
/// Smallest extent of the world, m.
const EXTENT_MIN_M: f64 = 5.0;
const TRUTH: Stroke = Stroke::solid(BLUE, 1.2);
const TRACK: Stroke = Stroke::solid(ORANGE, 1.6);
const BEST: Stroke = Stroke::solid(VERMILION, 1.6);
const MODE: Stroke = Stroke::solid(GREEN, 0.7).faint(0.4);
/// Radius of a detection, and of the present position, pt.
const DETECTION: f64 = 1.4;
const NOW: f64 = 2.4;

/// An agent to draw.
#[derive(Clone, Debug, Default)]
pub struct NoisyTrack {
    /// The name of the recording and the agent.
    pub title: String,
    /// Further text, in smaller type.
    pub note: String,
    /// Measured positions.
    pub detections: Vec<Point>,
    /// Published positions, oldest first. The last one is the present.
    pub track: Vec<Point>,
    /// True positions, from the past to the end of the forecast.
    pub truth: Vec<Point>,
    /// The single best forecast.
    pub best: Vec<Point>,
    /// The modes.
    pub modes: Vec<Vec<Point>>,
}

/// Draws an agent as one picture of the given width, pt, with north up. `height_per_width` is the ratio of the
/// panel's sides.
///
/// # Errors
/// [`PictureError`] if the agent has no track, or an option is out of range.
pub fn noisy_track(drawing: &NoisyTrack, width: f64, height_per_width: f64) -> Result<String, PictureError> {
    within("the width", width, 100.0, 2_000.0)?;
    within("the height relative to the width", height_per_width, 0.1, 10.0)?;
    let NoisyTrack { detections, track, truth, best, modes, .. } = drawing;
    let now = *track.last().ok_or(PictureError::Empty)?;
    let side = width - 2.0 * EDGE;
    let frame = Frame { corner: [EDGE, EDGE + 2.0 * ROW], size: [side, height_per_width * side] };
    let places = [detections, track, truth, best].into_iter().flatten();
    let places = places.map(|point| point.map(f64::from)).filter(|place| place.iter().all(|x| x.is_finite()));
    let view = View::of(places, frame, EXTENT_MIN_M).ok_or(PictureError::Empty)?;
    let spots = |points: &[Point]| -> Vec<Spot> {
        points.iter().map(|point| view.spot(point.map(f64::from))).collect()
    };
    let ahead = |points: &[Point]| Path::line(spots(&[&[now], points].concat()));

    let mut canvas = Canvas::new([width, frame.bottom() + ROW + EDGE]);
    let title = Type { size: 9.0, face: Face::Medium, colour: INK, align: Align::Left };
    canvas.fitted_text([EDGE, EDGE + 0.75 * ROW], title, &drawing.title, side);
    let note = Type { size: 7.0, face: Face::Regular, colour: GREY, align: Align::Left };
    canvas.fitted_text([EDGE, EDGE + 1.7 * ROW], note, &drawing.note, side);
    canvas.clipped(frame, |canvas| {
        modes.iter().for_each(|mode| canvas.stroke(&ahead(mode), &MODE));
        canvas.stroke(&Path::line(spots(truth)), &TRUTH);
        spots(detections).into_iter().for_each(|spot| canvas.fill(&Path::disc(spot, DETECTION), GREY, 0.8));
        canvas.stroke(&Path::line(spots(track)), &TRACK);
        canvas.stroke(&ahead(best), &BEST);
        canvas.fill(&Path::disc(view.spot(now.map(f64::from)), NOW), INK, 1.0);
        draw_scale_bar(canvas, &view);
    });
    canvas.stroke_frame(frame, &Stroke::solid(GREY, 0.5));
    draw_legend(&mut canvas, frame.bottom() + 0.75 * ROW);
    Ok(canvas.finish(&drawing.title))
}

fn draw_legend(canvas: &mut Canvas, baseline: f64) {
    let look = Type { size: LABEL_SIZE, face: Face::Regular, colour: INK, align: Align::Left };
    let (mut left, middle) = (EDGE, baseline - 2.3);
    let entries = [
        ("detections", None),
        ("track", Some(TRACK)),
        ("truth", Some(TRUTH)),
        ("best forecast", Some(BEST)),
        ("modes", Some(MODE)),
    ];
    for (name, stroke) in entries {
        match stroke {
            Some(stroke) => canvas.stroke(&Path::line([[left, middle], [left + 12.0, middle]]), &stroke),
            None => canvas.fill(&Path::disc([left + 6.0, middle], DETECTION), GREY, 0.8),
        }
        canvas.text([left + 15.0, baseline], look, name);
        left += 27.0 + text::width(look.face, look.size, name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_contains_each_detection_and_each_mode() {
        let line = |from: i32, to: i32| (from..=to).map(|x| [x as f32, 0.0]).collect::<Vec<Point>>();
        let drawing = NoisyTrack {
            title: "agent 7".to_owned(),
            detections: line(-5, 0),
            track: line(-5, 0),
            truth: line(-5, 12),
            best: line(1, 12),
            modes: vec![line(1, 12); 3],
            ..NoisyTrack::default()
        };
        let svg = noisy_track(&drawing, 516.0, 0.6).unwrap();
        // One more of each in the legend.
        assert_eq!(svg.matches(&format!("fill=\"{GREY}\" fill-rule")).count(), 7);
        assert_eq!(svg.matches(&format!("stroke=\"{GREEN}\"")).count(), 4);
        assert!(noisy_track(&NoisyTrack { track: Vec::new(), ..drawing }, 516.0, 0.6).is_err());
    }
}
