//! Panels with axes, and curves in them.

use super::canvas::{Align, Canvas, Frame, Stroke, Type};
use super::colour::{Colour, GREY, INK, PALE};
use super::path::{Path, Spot};
use super::text::{self, Face};

/// Font sizes, pt.
const TITLE_SIZE: f64 = 8.0;
const LABEL_SIZE: f64 = 6.5;
/// Space for labels and title, pt: below and left for tick labels, above for the title, right for half a
/// label.
const ROOM: [f64; 4] = [20.0, 30.0, 12.0, 7.0];
/// Number of curve names side by side. `KEY_ROW` is the height of a row of them, pt.
const KEY_COLUMNS: usize = 2;
const KEY_ROW: f64 = 8.0;
/// Maximum number of drawn points of a curve: more than the dots of a line of this width.
const POINTS_MAX: usize = 600;
/// Approximate minimum number of ticks on an axis.
const TICKS: f64 = 4.0;
/// Share of the values at the start of a curve that may be above the axis.
const CLIPPED: f64 = 0.02;

/// A named curve: points in order of increasing x.
#[derive(Clone, Debug)]
pub struct Curve {
    pub name: String,
    pub points: Vec<[f64; 2]>,
    pub stroke: Stroke,
}

/// A marked point of a panel, with a text.
#[derive(Clone, Debug)]
pub struct Mark {
    pub point: [f64; 2],
    pub words: String,
}

/// A panel. Its title names the vertical axis; all panels share the horizontal axis.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    pub title: String,
    pub curves: Vec<Curve>,
    pub mark: Option<Mark>,
    /// Whether the vertical axis starts at 0.
    pub from_zero: bool,
}

impl Curve {
    /// A solid curve. Non-finite values are omitted.
    pub fn new(name: impl Into<String>, colour: Colour, points: impl Iterator<Item = [f64; 2]>) -> Self {
        let points = points.filter(|point| point[1].is_finite()).collect();
        Self { name: name.into(), points: thinned(points), stroke: Stroke::solid(colour, 1.0) }
    }

    /// The same curve, dashed.
    pub fn dashed(mut self) -> Self {
        self.stroke = self.stroke.dashed(&[2.2, 1.4]);
        self
    }
}

/// Averages neighbouring points, so that at most [`POINTS_MAX`] remain.
fn thinned(points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    if points.len() <= POINTS_MAX {
        return points;
    }
    let mean = |group: &[[f64; 2]]| {
        let of = |axis: usize| group.iter().map(|point| point[axis]).sum::<f64>() / group.len() as f64;
        [of(0), of(1)]
    };
    points.chunks(points.len().div_ceil(POINTS_MAX)).map(mean).collect()
}

/// A range of values and its position on paper.
#[derive(Clone, Copy, Debug)]
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Axis {
    fn at(&self, value: f64) -> f64 {
        self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)
    }

    /// Round values along the axis, at a round distance from each other.
    fn ticks(&self) -> Vec<f64> {
        let step = round_step((self.high - self.low) / TICKS);
        let first = (self.low / step - 1e-9).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last).map(|tick| tick as f64 * step).collect()
    }
}

/// The largest of 1, 2 and 5 times a power of ten that does not exceed `most`.
fn round_step(most: f64) -> f64 {
    let power = 10.0_f64.powf(most.log10().floor());
    [5.0, 2.0].into_iter().map(|factor| factor * power).find(|step| *step <= most).unwrap_or(power)
}

impl Chart {
    /// Draws the panel into a frame that includes titles and labels. `steps` is the range of the horizontal
    /// axis.
    pub fn draw(&self, canvas: &mut Canvas, frame: Frame, steps: [f64; 2]) {
        let [below, left, above, right] = ROOM;
        let plot = Frame {
            corner: [frame.corner[0] + left, frame.corner[1] + above],
            size: [frame.size[0] - left - right, frame.size[1] - above - below],
        };
        let [low, high] = self.range();
        // The names of the curves are above all values.
        let high = high + (high - low) * (self.key_height() / plot.size[1]).min(0.5);
        let x = Axis { low: steps[0], high: steps[1], start: plot.corner[0], end: plot.right() };
        let y = Axis { low, high, start: plot.bottom(), end: plot.corner[1] };
        let title = Type { size: TITLE_SIZE, face: Face::Medium, colour: INK, align: Align::Left };
        canvas.text([plot.corner[0], frame.corner[1] + 8.0], title, &self.title);
        draw_ticks(canvas, plot, x, y);
        canvas.clipped(plot, |canvas| {
            for curve in &self.curves {
                let spots = curve.points.iter().map(|point| [x.at(point[0]), y.at(point[1])]);
                canvas.stroke(&Path::line(spots), &curve.stroke);
            }
        });
        canvas.stroke_frame(plot, &Stroke::solid(GREY, 0.5));
        if let Some(mark) = &self.mark {
            draw_mark(canvas, plot, [x.at(mark.point[0]), y.at(mark.point[1])], &mark.words);
        }
        self.draw_key(canvas, plot);
    }

    /// The range of the vertical axis. It contains all values except the highest few, which come from the
    /// start of training.
    fn range(&self) -> [f64; 2] {
        let mut values: Vec<f64> =
            self.curves.iter().flat_map(|curve| &curve.points).map(|point| point[1]).collect();
        values.sort_by(f64::total_cmp);
        let Some(&lowest) = values.first() else { return [0.0, 1.0] };
        let highest = values[(values.len() - 1) - ((values.len() as f64 * CLIPPED) as usize)];
        let low = if self.from_zero { lowest.min(0.0) } else { lowest };
        let pad = (0.06 * (highest - low)).max(1e-6 * highest.abs()).max(1e-12);
        [if self.from_zero && lowest >= 0.0 { 0.0 } else { low - pad }, highest + pad]
    }

    fn named(&self) -> Vec<&Curve> {
        self.curves.iter().filter(|curve| !curve.name.is_empty()).collect()
    }

    fn key_height(&self) -> f64 {
        let rows = self.named().len().div_ceil(KEY_COLUMNS);
        if rows == 0 { 0.0 } else { rows as f64 * KEY_ROW + 3.0 }
    }

    /// Draws the names of the curves in the upper right corner.
    fn draw_key(&self, canvas: &mut Canvas, plot: Frame) {
        let named = self.named();
        let width = |curve: &&Curve| text::width(Face::Regular, LABEL_SIZE, &curve.name);
        let column = named.iter().map(width).fold(0.0, f64::max) + 22.0;
        let columns = KEY_COLUMNS.min(named.len());
        let look = Type { size: LABEL_SIZE, face: Face::Regular, colour: INK, align: Align::Left };
        for (number, curve) in named.into_iter().enumerate() {
            let left = plot.right() - (columns - number % KEY_COLUMNS) as f64 * column;
            let baseline = plot.corner[1] + 9.0 + (number / KEY_COLUMNS) as f64 * KEY_ROW;
            let sample = Path::line([[left, baseline - 2.3], [left + 11.0, baseline - 2.3]]);
            canvas.stroke(&sample, &curve.stroke);
            canvas.text([left + 14.0, baseline], look, &curve.name);
        }
    }
}

fn draw_ticks(canvas: &mut Canvas, plot: Frame, x: Axis, y: Axis) {
    let look = |align| Type { size: LABEL_SIZE, face: Face::Regular, colour: INK, align };
    let grid = Stroke::solid(PALE, 0.3);
    let tick = Stroke::solid(GREY, 0.5);
    for value in x.ticks() {
        let at = x.at(value);
        canvas.stroke(&Path::line([[at, plot.corner[1]], [at, plot.bottom()]]), &grid);
        canvas.stroke(&Path::line([[at, plot.bottom()], [at, plot.bottom() + 2.0]]), &tick);
        canvas.text([at, plot.bottom() + 8.5], look(Align::Middle), &short(value));
    }
    for value in y.ticks() {
        let at = y.at(value);
        canvas.stroke(&Path::line([[plot.corner[0], at], [plot.right(), at]]), &grid);
        canvas.stroke(&Path::line([[plot.corner[0] - 2.0, at], [plot.corner[0], at]]), &tick);
        canvas.text([plot.corner[0] - 4.0, at + 2.3], look(Align::Right), &short(value));
    }
    canvas.text([plot.centre_x(), plot.bottom() + 16.5], look(Align::Middle), "step");
}

fn draw_mark(canvas: &mut Canvas, plot: Frame, spot: Spot, words: &str) {
    let line = Path::line([[spot[0], plot.corner[1]], [spot[0], plot.bottom()]]);
    canvas.stroke(&line, &Stroke::solid(INK, 0.5).dashed(&[1.5, 1.5]));
    canvas.fill(&Path::disc(spot, 2.2), INK, 1.0);
    let is_left = spot[0] < plot.centre_x();
    let (align, aside) = if is_left { (Align::Left, 3.0) } else { (Align::Right, -3.0) };
    let look = Type { size: LABEL_SIZE, face: Face::Regular, colour: INK, align };
    canvas.text([spot[0] + aside, plot.corner[1] + 8.0], look, words);
}

/// Formats a round number in few characters.
fn short(value: f64) -> String {
    let size = value.abs();
    let trimmed = |text: String| {
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    };
    let text = match size {
        0.0 => "0".to_owned(),
        _ if size >= 1e6 => trimmed(format!("{:.2}", value / 1e6)) + "M",
        _ if size >= 1e3 => trimmed(format!("{:.2}", value / 1e3)) + "k",
        _ if size >= 1e-3 => trimmed(format!("{value:.4}")),
        _ => format!("{value:.0e}"),
    };
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        for (low, high) in [(0.0, 1.0), (-3.0, 17.0), (0.212, 0.219), (0.0, 40_000.0)] {
            let axis = Axis { low, high, start: 0.0, end: 100.0 };
            let ticks = axis.ticks();
            assert!((4..=11).contains(&ticks.len()), "{low}..{high}: {ticks:?}");
            assert!(ticks.iter().all(|tick| (low - 1e-9..=high + 1e-9).contains(tick)), "{ticks:?}");
        }
    }

    #[test]
    fn labels_are_short() {
        let labels = [0.0, 0.25, -1.5, 12.0, 1500.0, 2e6, 5e-5].map(short);
        assert_eq!(labels, ["0", "0.25", "−1.5", "12", "1.5k", "2M", "5e−5"]);
    }

    #[test]
    fn long_curves_are_thinned_to_their_means() {
        let curve = Curve::new("", INK, (0..6_000).map(|x| [f64::from(x), f64::from(x % 10)]));
        assert_eq!(curve.points.len(), POINTS_MAX);
        assert!(curve.points.iter().all(|point| point[1] == 4.5));
    }
}
