//! What the lines and areas of the panels mean.

use wire::Cause;
use wire::vocabulary::LOOKS;

use super::agent::{BEST, HINDSIGHT, HISTORY, LIKELIEST, MODE, OTHER, REGION_OPACITY, TRUTH, cause_colour};
use super::content::{AgentDrawing, LABEL_SIZE, SceneDrawing, SceneOptions};
use crate::canvas::{Align, Canvas, Frame, Stroke, Type};
use crate::colour::{Colour, GREEN, GREY, INK, WHITE};
use crate::ground::{self, LANE};
use crate::mask::{Mask, SHARES};
use crate::path::{Path, Spot};
use crate::text::{self, Face};

/// Width and height of a sample, the space to its text and to the next entry, and the height of a line, pt.
const SAMPLE: [f64; 2] = [16.0, 6.0];
const TO_WORDS: f64 = 3.5;
const TO_NEXT: f64 = 11.0;
const LINE_HEIGHT: f64 = 11.0;
/// Height of the text above the baseline, pt.
const ASCENT: f64 = 5.0;

/// A legend below the panels.
pub struct Legend {
    entries: Vec<Entry>,
    width: f64,
}

struct Entry {
    words: String,
    sample: Sample,
}

enum Sample {
    Line(Stroke),
    Area(f64),
    Agent(Colour),
    Body,
    Ground,
}

impl Entry {
    fn new(words: impl Into<String>, sample: Sample) -> Self {
        Self { words: words.into(), sample }
    }

    fn width(&self) -> f64 {
        SAMPLE[0] + TO_WORDS + text::width(Face::Regular, LABEL_SIZE, &self.words)
    }
}

impl Legend {
    /// The entries for everything that the drawings show.
    pub fn of(drawings: &[SceneDrawing<'_>], options: &SceneOptions, width: f64) -> Self {
        let mut entries = vec![Entry::new("history", Sample::Line(HISTORY))];
        let mut add = |words: &str, sample| entries.push(Entry::new(words, sample));
        let agents = || drawings.iter().flat_map(|drawing| &drawing.agents);
        let has_truth = agents().any(|AgentDrawing { agent, truth }| {
            agent.forecast.is_some() && truth.iter().any(Option::is_some)
        });
        if has_truth {
            add("ground truth", Sample::Line(TRUTH));
        }
        let forecasts = || agents().filter_map(|drawing| drawing.agent.forecast.as_ref());
        let modes_len = forecasts().map(|forecast| forecast.modes.len()).max();
        if let Some(modes_len) = modes_len {
            add("best forecast", Sample::Line(BEST));
            add("most probable mode", Sample::Line(LIKELIEST));
            add("all modes", Sample::Line(MODE.faint(0.6)));
            if has_truth {
                add(&format!("best of {modes_len} in hindsight"), Sample::Line(HINDSIGHT));
            }
            if options.mask != Mask::Hidden {
                let [outer, inner] = SHARES.map(|share| format!("{:.0} %", 100.0 * share));
                let [first, second] = REGION_OPACITY;
                add(&format!("{outer} region"), Sample::Area(first));
                add(&format!("{inner} region"), Sample::Area(1.0 - (1.0 - first) * (1.0 - second)));
            }
        }
        // Learned forecasts are the usual case.
        for look in LOOKS.iter().filter(|look| look.cause != Cause::None) {
            let number = look.cause as u32;
            if forecasts().any(|forecast| forecast.cause == number) {
                add(look.words, Sample::Agent(cause_colour(number)));
            }
        }
        if agents().any(|drawing| drawing.agent.forecast.is_none()) && modes_len.is_some() {
            add("other agents", Sample::Body);
        }
        if drawings.iter().any(|drawing| !drawing.lanes.is_empty()) {
            add("lanes", Sample::Line(LANE));
        }
        if drawings.iter().any(|drawing| drawing.map.is_some()) {
            add("visits, few to many", Sample::Ground);
        }
        Self { entries, width }
    }

    /// The height of the legend, pt.
    pub fn height(&self) -> f64 {
        self.lines().len() as f64 * LINE_HEIGHT
    }

    /// Draws the legend, with each line centred.
    pub fn draw(&self, canvas: &mut Canvas, [left, top]: Spot) {
        let look = Type { size: LABEL_SIZE, face: Face::Regular, colour: INK, align: Align::Left };
        for (number, line) in self.lines().into_iter().enumerate() {
            let mut x = left + (self.width - width(line)) / 2.0;
            let baseline = top + number as f64 * LINE_HEIGHT + 0.7 * LINE_HEIGHT;
            for entry in line {
                entry.sample.draw(canvas, [x, baseline - ASCENT / 2.0]);
                canvas.text([x + SAMPLE[0] + TO_WORDS, baseline], look, &entry.words);
                x += entry.width() + TO_NEXT;
            }
        }
    }

    /// The entries, split into about equally full lines.
    fn lines(&self) -> Vec<&[Entry]> {
        let line_count = (width(&self.entries) / self.width).ceil().max(1.0) as usize;
        (line_count..=self.entries.len())
            .map(|line_count| self.entries.chunks(self.entries.len().div_ceil(line_count)).collect())
            .find(|lines: &Vec<&[Entry]>| lines.iter().all(|line| width(line) <= self.width))
            .unwrap_or_else(|| self.entries.chunks(1).collect())
    }
}

fn width(entries: &[Entry]) -> f64 {
    entries.iter().map(Entry::width).sum::<f64>() + entries.len().saturating_sub(1) as f64 * TO_NEXT
}

impl Sample {
    fn draw(&self, canvas: &mut Canvas, [left, middle]: Spot) {
        let [width, height] = SAMPLE;
        let frame = Frame { corner: [left, middle - height / 2.0], size: SAMPLE };
        match self {
            Self::Line(stroke) => {
                canvas.stroke(&Path::line([[left, middle], [left + width, middle]]), stroke);
            }
            Self::Area(opacity) => {
                let corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
                let area = Path::polygon(corners.map(|[x, y]| [left + x, frame.corner[1] + y]));
                canvas.fill(&area, GREEN, *opacity);
            }
            Self::Agent(colour) => {
                let body = Frame { corner: [left + 0.5 * width - 4.0, middle - 1.8], size: [8.0, 3.6] };
                canvas.fill_frame(body, *colour);
            }
            Self::Body => {
                let trace = Path::line([[left, middle], [left + width, middle]]);
                canvas.stroke(&trace, &OTHER);
                let body = Frame { corner: [left + width - 8.0, middle - 1.6], size: [8.0, 3.2] };
                canvas.fill_frame(body, WHITE);
                canvas.stroke_frame(body, &Stroke::solid(GREY, 0.5));
            }
            Self::Ground => {
                let ramp = ground::ramp();
                let size = [width / ramp.len() as f64, height];
                for (index, colour) in ramp.enumerate() {
                    let corner = [left + index as f64 * size[0], frame.corner[1]];
                    canvas.fill_frame(Frame { corner, size }, colour);
                }
                canvas.stroke_frame(frame, &Stroke::solid(GREY, 0.3));
            }
        }
    }
}
