//! An agent with its history, its future and its forecast.

use metrics::Point;
use scene::AgentType;
use wire::Cause;
use wire::tick_view::{AgentView, ForecastView};
use wire::vocabulary::{self, Look};

use crate::canvas::{Canvas, Stroke};
use crate::colour::{BLUE, Colour, GREEN, GREY, INK, ORANGE, PALE, PURPLE, VERMILION, WHITE};
use crate::contour::{Place, simplified};
use crate::mask::{Mask, Outline};
use crate::path::Path;
use crate::scene::content::AgentDrawing;
use crate::view::View;

/// The look of each line. The legend uses the same looks.
pub const HISTORY: Stroke = Stroke::solid(ORANGE, 1.5);
pub const TRUTH: Stroke = Stroke::solid(BLUE, 1.3).dashed(&[3.2, 1.8]);
pub const BEST: Stroke = Stroke::solid(VERMILION, 1.3);
pub const HINDSIGHT: Stroke = Stroke::solid(INK, 0.5).dashed(&[1.6, 1.0]);
pub const LIKELIEST: Stroke = Stroke::solid(PURPLE, 1.1).dashed(&[0.9, 1.3]);
pub const MODE: Stroke = Stroke::solid(Colour([0, 92, 66]), 0.5);
pub const OTHER: Stroke = Stroke::solid(PALE, 0.8);
/// Opacity of the regions of a mask, largest region first.
pub const REGION_OPACITY: [f64; 2] = [0.28, 0.42];
/// Opacity of the least and the most probable mode.
const MODE_OPACITY: [f64; 2] = [0.08, 0.8];
/// White halo around lines that must be visible on any ground.
const HALO: Stroke = Stroke::solid(WHITE, 2.6).faint(0.75);
/// Radius of the mark at the end of a line, pt.
const END_RADIUS: f64 = 1.5;
/// Smallest half extent of a body on paper, pt.
const BODY_MIN: f64 = 1.5;

/// An agent, prepared for drawing.
pub struct Sketch<'a> {
    pub agent: &'a AgentView,
    truth: &'a [Option<Point>],
    regions: Vec<Outline>,
    best: Option<&'a [Point]>,
    likeliest: Option<&'a [Point]>,
    hindsight: Option<&'a [Point]>,
}

impl<'a> Sketch<'a> {
    pub fn new(AgentDrawing { agent, truth }: &'a AgentDrawing, mask: Mask) -> Self {
        let forecast = agent.forecast.as_ref();
        Self {
            agent,
            truth,
            regions: forecast
                .map(|forecast| mask.regions(place(agent.position_m), forecast))
                .unwrap_or_default(),
            best: forecast.map(|forecast| forecast.best.as_slice()),
            likeliest: forecast.and_then(|forecast| {
                metrics::most_likely(&forecast.probability).map(|mode| forecast.modes[mode].as_slice())
            }),
            hindsight: forecast.and_then(|forecast| hindsight(forecast, truth)),
        }
    }

    /// All positions of the agent that the view must show.
    pub fn places(&self) -> impl Iterator<Item = Place> {
        let lines = self.best.into_iter().chain(self.likeliest).flatten();
        let known = self.agent.history.iter().chain(self.truth).flatten();
        let regions = self.regions.iter().flat_map(|outline| outline.iter().flatten().copied());
        lines.chain(known).chain([&self.agent.position_m]).map(|point| place(*point)).chain(regions)
    }

    /// Draws a region of the mask: number 0 is the larger region, number 1 the smaller one.
    pub fn draw_region(&self, number: usize, canvas: &mut Canvas, view: &View) {
        let Some(outline) = self.regions.get(number) else { return };
        let mut path = Path::default();
        for line in outline {
            let spots: Vec<_> = line.iter().map(|place| view.spot(*place)).collect();
            path.add_line(simplified(&spots, 0.04));
            path.close();
        }
        canvas.fill(&path, GREEN, 1.0);
    }

    pub fn draw_modes(&self, canvas: &mut Canvas, view: &View) {
        let Some(forecast) = &self.agent.forecast else { return };
        let likeliest = forecast.probability.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
        let [least, most] = MODE_OPACITY;
        for (mode, probability) in forecast.modes.iter().zip(&forecast.probability) {
            let share = f64::from(probability / likeliest);
            let line = from_now(view, self.agent.position_m, mode);
            canvas.stroke(&line, &MODE.faint(least + (most - least) * share));
        }
    }

    pub fn draw_lines(&self, canvas: &mut Canvas, view: &View) {
        let (history, truth) = (self.history(view), self.truth(view));
        if self.agent.forecast.is_none() {
            canvas.stroke(&history, &OTHER);
            return;
        }
        let mode = |mode: Option<&[Point]>| {
            mode.map(|mode| from_now(view, self.agent.position_m, mode)).unwrap_or_default()
        };
        let [best, likeliest, hindsight] = [self.best, self.likeliest, self.hindsight].map(mode);
        for line in [&truth, &best, &history] {
            canvas.stroke(line, &HALO);
        }
        for (line, look) in [
            (&truth, &TRUTH),
            (&hindsight, &HINDSIGHT),
            (&likeliest, &LIKELIEST),
            (&best, &BEST),
            (&history, &HISTORY),
        ] {
            canvas.stroke(line, look);
        }
    }

    /// Marks the ends of the truth and the forecasts.
    pub fn draw_ends(&self, canvas: &mut Canvas, view: &View) {
        if self.agent.forecast.is_none() {
            return;
        }
        let end = |line: Option<&[Point]>| line.and_then(<[Point]>::last).copied();
        for (point, colour) in [
            (self.truth.last().copied().flatten(), BLUE),
            (end(self.likeliest), PURPLE),
            (end(self.best), VERMILION),
        ] {
            let Some(point) = point else { continue };
            let disc = Path::disc(view.spot(place(point)), END_RADIUS);
            canvas.fill(&disc, colour, 1.0);
            canvas.stroke(&disc, &Stroke::solid(WHITE, 0.4));
        }
    }

    pub fn draw_body(&self, canvas: &mut Canvas, view: &View) {
        let AgentView { agent_type, heading_rad, length_m, width_m, position_m, .. } = *self.agent;
        let (fill, edge) = match &self.agent.forecast {
            Some(forecast) => (cause_colour(forecast.cause), Stroke::solid(WHITE, 0.5)),
            None => (WHITE, Stroke::solid(GREY, 0.5)),
        };
        let spot = view.spot(place(position_m));
        let half = |size_m: Option<f32>, usual_m: f32| {
            let size_m = size_m.filter(|size_m| *size_m > 0.0).unwrap_or(usual_m);
            (0.5 * f64::from(size_m) * view.scale()).max(BODY_MIN)
        };
        let (sin, cos) = f64::from(heading_rad).sin_cos();
        // North is up on paper, but y points down.
        let at =
            |along: f64, left: f64| [spot[0] + along * cos - left * sin, spot[1] - along * sin - left * cos];
        if agent_type == AgentType::Vehicle {
            let (length, width) = (half(length_m, 4.5), half(width_m, 1.8));
            let body = Path::polygon([
                at(length, width),
                at(length, -width),
                at(-length, -width),
                at(-length, width),
            ]);
            canvas.fill(&body, fill, 1.0);
            canvas.stroke(&body, &edge);
            // The windscreen marks the front.
            let screen = Path::line([at(0.45 * length, 0.7 * width), at(0.45 * length, -0.7 * width)]);
            canvas.stroke(&screen, &edge);
            return;
        }
        let is_cyclist = agent_type == AgentType::Cyclist;
        let radius = half(width_m, if is_cyclist { 0.8 } else { 0.55 });
        let disc = Path::disc(spot, radius);
        canvas.fill(&disc, fill, 1.0);
        canvas.stroke(&disc, &edge);
        if is_cyclist {
            canvas.fill(&Path::disc(spot, 0.4 * radius), edge.colour, 1.0);
        }
    }

    /// The history, extended to the present position.
    fn history(&self, view: &View) -> Path {
        broken(view, self.agent.history.iter().copied().chain([Some(self.agent.position_m)]))
    }

    fn truth(&self, view: &View) -> Path {
        broken(view, [Some(self.agent.position_m)].into_iter().chain(self.truth.iter().copied()))
    }
}

/// The colour of an agent by the cause of its forecast. Learned forecasts are the usual case, in ink.
pub fn cause_colour(cause: u32) -> Colour {
    match vocabulary::look(cause) {
        Some(Look { cause: Cause::None, .. }) => INK,
        Some(look) => Colour(look.light),
        None => Colour(vocabulary::UNKNOWN[0]),
    }
}

/// The mode with the smallest mean distance to the truth: known in hindsight only. Returns `None` if the truth is
/// unknown at all steps.
pub fn hindsight<'a>(forecast: &'a ForecastView, truth: &[Option<Point>]) -> Option<&'a [Point]> {
    let known_len = forecast.modes.first().map_or(0, Vec::len).min(truth.len());
    forecast
        .modes
        .iter()
        .filter_map(|mode| Some((mode, metrics::displacement(mode, &truth[..known_len]).ade_m?)))
        .min_by(|(_, a), (_, b)| a.total_cmp(b))
        .map(|(mode, _)| mode.as_slice())
}

fn place(point: Point) -> Place {
    point.map(f64::from)
}

fn from_now(view: &View, now: Point, mode: &[Point]) -> Path {
    Path::line([now].iter().chain(mode).map(|point| view.spot(place(*point))))
}

/// A line through all known points, broken at unknown points.
fn broken(view: &View, points: impl Iterator<Item = Option<Point>>) -> Path {
    let mut path = Path::default();
    let mut part = Vec::new();
    for point in points.chain([None]) {
        match point {
            Some(point) => part.push(view.spot(place(point))),
            None => path.add_line(part.drain(..)),
        }
    }
    path
}
