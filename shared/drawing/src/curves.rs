//! Learning curves of a training run.

use super::axes::{Chart, Curve, Mark};
use super::canvas::{Align, Canvas, Frame, Type};
use super::colour::{CURVES, Colour, GREY, INK};
use super::error::PictureError;
use super::text::Face;
use super::training_log::{Progress, SetErrors, TrainingLog};

/// Width of the picture, height of a panel, space between panels, edge of the sheet, and space for the title,
/// pt.
const WIDTH: f64 = 516.0;
const PANEL_HEIGHT: f64 = 128.0;
const GAP: f64 = 10.0;
const EDGE: f64 = 4.0;
const TITLE_HEIGHT: f64 = 16.0;
const COLUMNS: usize = 3;

/// Draws the learning curves of a training run.
///
/// The upper panels show the loss, its terms and the learning rate. The lower panels show the figure that
/// selects the checkpoint, with the selected checkpoint marked, and the errors on each validation set.
///
/// # Errors
/// [`PictureError::Empty`] if the log has no entries.
pub fn learning_curves(log: &TrainingLog, title: &str) -> Result<String, PictureError> {
    let last_step = log.progress.last().map(|progress| progress.step);
    let last_step = last_step.max(log.validations.last().map(|entry| entry.step));
    let last_step = last_step.ok_or(PictureError::Empty)?;
    let charts = [training_charts(log), validation_charts(log)].concat();
    let charts: Vec<&Chart> = charts.iter().filter(|chart| !chart.curves.is_empty()).collect();
    let rows = charts.len().div_ceil(COLUMNS);
    let panel_width = (WIDTH - 2.0 * EDGE - (COLUMNS - 1) as f64 * GAP) / COLUMNS as f64;
    let row_height = PANEL_HEIGHT + GAP;
    let mut canvas = Canvas::new([WIDTH, EDGE + TITLE_HEIGHT + rows as f64 * row_height]);
    let mut look = Type { size: 9.0, face: Face::Medium, colour: INK, align: Align::Left };
    let title_width = canvas.text([EDGE, EDGE + 9.0], look, title);
    look = Type { size: 7.0, face: Face::Regular, colour: GREY, ..look };
    canvas.text([EDGE + title_width + 6.0, EDGE + 9.0], look, &summary(log, last_step));
    for (index, chart) in charts.into_iter().enumerate() {
        let corner = [
            EDGE + (index % COLUMNS) as f64 * (panel_width + GAP),
            EDGE + TITLE_HEIGHT + (index / COLUMNS) as f64 * row_height,
        ];
        let frame = Frame { corner, size: [panel_width, PANEL_HEIGHT] };
        chart.draw(&mut canvas, frame, [0.0, last_step.max(1) as f64]);
    }
    Ok(canvas.finish(title))
}

fn summary(log: &TrainingLog, last_step: u64) -> String {
    let time = log.progress.last().map(|progress| {
        let minutes = (progress.seconds / 60.0).round() as u64;
        format!(" in {} h {:02} min", minutes / 60, minutes % 60)
    });
    let best =
        log.best().map(|best| format!("; best checkpoint at step {}: {:.4}", best.step, best.validation));
    format!("{last_step} steps{}{}", time.unwrap_or_default(), best.unwrap_or_default())
}

fn training_charts(log: &TrainingLog) -> Vec<Chart> {
    let curve = |name: &str, colour: Colour, value: fn(&Progress) -> f64| {
        Curve::new(name, colour, log.progress.iter().map(move |p| [p.step as f64, value(p)]))
    };
    let chart = |title: &str, curves: Vec<Curve>, from_zero: bool| Chart {
        title: title.to_owned(),
        curves: curves.into_iter().filter(|curve| !curve.points.is_empty()).collect(),
        mark: None,
        from_zero,
    };
    vec![
        chart("Training loss", vec![curve("", INK, |p| p.loss)], false),
        chart(
            "Terms of the loss",
            vec![
                curve("best mode", CURVES[0], |p| p.trajectory),
                curve("single", CURVES[1], |p| p.single),
                curve("probability", CURVES[2], |p| p.probability),
                curve("spread", CURVES[3], |p| p.spread),
            ],
            false,
        ),
        chart("Learning rate", vec![curve("", INK, |p| p.rate)], true),
    ]
}

fn validation_charts(log: &TrainingLog) -> Vec<Chart> {
    let figure = log.validations.iter().map(|entry| [entry.step as f64, entry.validation]);
    let figure = Curve::new("", INK, figure);
    let mark = log.best().map(|best| Mark {
        point: [best.step as f64, best.validation],
        words: format!("best: {:.4}", best.validation),
    });
    let charts = vec![
        Chart { title: "Validation figure".to_owned(), curves: vec![figure], mark, from_zero: false },
        errors_chart(log, "Best mode, ADE and FDE (dashed), m", |errors| {
            [errors.best_of_modes.ade_m, errors.best_of_modes.fde_m]
        }),
        errors_chart(log, "Single, ADE and FDE (dashed), m", |errors| {
            [errors.single.ade_m, errors.single.fde_m]
        }),
    ];
    let is_drawn = |chart: &Chart| chart.curves.iter().any(|curve| !curve.points.is_empty());
    charts.into_iter().filter(is_drawn).collect()
}

/// One colour per set; ADE is solid and FDE dashed.
fn errors_chart(log: &TrainingLog, title: &str, of: fn(&SetErrors) -> [f64; 2]) -> Chart {
    let mut names: Vec<&str> =
        log.validations.iter().flat_map(|entry| &entry.sets).map(|errors| errors.set.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let curves = names.iter().enumerate().flat_map(|(number, name)| {
        let colour = CURVES[number % CURVES.len()];
        let points = |which: usize| {
            let validations = log.validations.iter();
            validations.filter_map(move |entry| {
                let errors = entry.sets.iter().find(|errors| errors.set == *name)?;
                Some([entry.step as f64, of(errors)[which]])
            })
        };
        [Curve::new(*name, colour, points(0)), Curve::new("", colour, points(1)).dashed()]
    });
    Chart { title: title.to_owned(), curves: curves.collect(), mark: None, from_zero: true }
}
