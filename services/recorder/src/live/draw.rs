use super::{LiveStage, LiveView};
use crate::screen::{BOLD, Color, DIM, Line, Span, TITLE, curve};
use crate::text::{bar, count, number, percent};

/// Smallest and largest number of cells of a budget bar.
const BAR_WIDTHS: [usize; 2] = [8, 24];
/// Number of cells of a line without its bar.
const FIXED_WIDTH: usize = 62;
/// Smallest and largest number of rows of the latency curve, including its caption and the row above.
const CURVE_HEIGHTS: [usize; 2] = [4, 6];
/// Rows around the table and the curve.
const OTHER_HEIGHT: usize = 5;

/// The view in at most `height` lines of `width` cells.
#[must_use]
pub fn lines(view: &LiveView, width: usize, height: usize) -> Vec<Line> {
    let cells = width.saturating_sub(FIXED_WIDTH).clamp(BAR_WIDTHS[0], BAR_WIDTHS[1]);
    let mut lines = vec![title(view, width), Line::default(), heading(cells)];
    let stages = view.stages();
    lines.extend(stages.iter().map(|(stage, row)| stage_line(stage.name(), row, cells)));
    lines.push(end_to_end_line(view, cells));
    // On a low terminal the curve is left out first.
    let [least, most] = CURVE_HEIGHTS;
    let left = height.saturating_sub(stages.len() + 2 + OTHER_HEIGHT).min(most);
    if left >= least {
        lines.extend(latency_curve(view, width, left - 2));
    }
    lines.extend(forecasts(view));
    lines.truncate(height);
    lines
}

fn title(view: &LiveView, width: usize) -> Line {
    let tick = match view.options.ticks_limit {
        Some(limit) => format!("tick {} of {}", count(view.ticks), count(limit)),
        None => format!("tick {}", count(view.ticks)),
    };
    let elapsed_s = view.elapsed_s();
    let (minutes, seconds) = ((elapsed_s / 60.0) as u64, elapsed_s % 60.0);
    let time = format!("{tick}   {minutes:02}:{seconds:04.1} ");
    let left = Line(vec![Span::styled(" stgdat ", TITLE), Span::raw(format!(" {}", view.options.title))]);
    let room = width.saturating_sub(time.len());
    let mut title = left.cut(room);
    title.0.push(Span::raw(" ".repeat(room - title.width()) + &time));
    title
}

fn heading(cells: usize) -> Line {
    let text = format!(
        "   {:8}{:>11}{:>8}  {:bars$}{:>10}{:>6}{:>6}",
        "stage",
        "compute p50",
        "p99 ms",
        "p99 of budget",
        "frames",
        "over",
        "lost",
        bars = cells + 7
    );
    Line::styled(text, DIM)
}

fn stage_line(name: &str, stage: &LiveStage, cells: usize) -> Line {
    let (mark, colour) = match stage.alive {
        None => ("○", Color::BrightBlack),
        Some(true) => ("●", Color::Green),
        Some(false) => ("●", Color::Red),
    };
    let mut spans = vec![
        Span::colored(format!(" {mark} "), colour),
        Span::raw(format!(
            "{name:11}{:>8}{:>8}  ",
            number(stage.compute_ms_p50),
            number(stage.compute_ms_p99)
        )),
    ];
    let share = stage.compute_ms_p99.zip(stage.budget_ms).map(|(p99, budget)| p99 / budget);
    spans.extend(budget_spans(share, cells));
    spans.push(Span::raw(format!("{:>10}", count(stage.frames))));
    spans.extend([fault(stage.late, 6), fault(stage.lost, 6)]);
    if stage.restarts > 0 {
        spans.push(Span::colored(format!("  restarted {}×", stage.restarts), Color::Yellow));
    }
    if stage.replaced > 0 {
        spans.push(Span::colored(format!("  replaced {}×", stage.replaced), Color::Cyan));
    }
    if let Some((state, promotions)) = stage.spare {
        let colour = if state == "ready" { Color::Green } else { Color::Yellow };
        spans.push(Span::colored(format!("  spare {state}"), colour));
        if promotions > 0 {
            spans.push(Span::colored(format!(", promoted {promotions}×"), Color::Yellow));
        }
    }
    if let Some(refused) = &stage.refused {
        let text = format!("  refused {} of the {}: {}", refused.frames, refused.sender, refused.cause);
        spans.push(Span::colored(text, Color::Red));
    }
    Line(spans)
}

fn end_to_end_line(view: &LiveView, cells: usize) -> Line {
    let [p50, p99] = view.end_to_end_ms();
    let limit_ms = view.limit_ns as f64 / 1e6;
    let mut spans = vec![
        Span::raw("   "),
        Span::styled(format!("{:11}{:>8}{:>8}  ", "end to end", number(p50), number(p99)), BOLD),
    ];
    spans.extend(budget_spans(p99.map(|p99| p99 / limit_ms), cells));
    spans.push(Span::styled(format!("{:>10}", count(view.ticks)), BOLD));
    let lost = view.losses.by_stage(&view.options.stages).iter().map(|drops| drops.total()).sum();
    spans.extend([fault(view.late_ticks, 6), fault(lost, 6)]);
    Line(spans)
}

fn budget_spans(share: Option<f64>, cells: usize) -> [Span; 2] {
    let colour = match share {
        None => Color::BrightBlack,
        Some(share) if share > 1.0 => Color::Red,
        Some(share) if share > 0.75 => Color::Yellow,
        Some(_) => Color::Green,
    };
    [
        Span::colored(share.map_or_else(|| " ".repeat(cells), |share| bar(share, cells)), colour),
        Span::raw(format!("{:>7}", percent(share))),
    ]
}

/// A count that should be 0.
fn fault(n: u64, width: usize) -> Span {
    Span::styled(format!("{:>width$}", count(n)), if n > 0 { Color::Red.on_default().bold() } else { DIM })
}

/// The end-to-end latencies of the last ticks, with a caption.
fn latency_curve(view: &LiveView, width: usize, height: usize) -> Vec<Line> {
    let width = width.saturating_sub(6);
    let newest = view.window.iter().rev().take(width);
    let newest_us: Vec<u64> =
        newest.map(|tick| tick.end_to_end_ns.unwrap_or(view.limit_ns) / 1_000).collect();
    let limit_us = view.limit_ns / 1_000;
    let most_us = newest_us.iter().copied().max().unwrap_or(limit_us);
    // Small latencies also fill the curve. Its height is the limit, halved while all values still fit.
    let mut scale_us = limit_us;
    while scale_us / 2 > most_us && scale_us > 2_000 {
        scale_us /= 2;
    }
    let text = format!("   end to end, newest right, full height {} ms", number(Some(scale_us as f64 / 1e3)));
    let colour = if most_us > limit_us { Color::Red } else { Color::Cyan };
    let rows = curve(&newest_us, scale_us, width, height);
    let rows = rows.into_iter().map(|row| Line(vec![Span::raw("   "), Span::colored(row, colour)]));
    [Line::default(), Line::styled(text, DIM)].into_iter().chain(rows).collect()
}

fn forecasts(view: &LiveView) -> [Line; 3] {
    let [learned, held, kinematic] = view.newest;
    let quality = |n: u64, name: &str, colour: Color| {
        Span::styled(format!("{n} {name}   "), if n > 0 { colour.on_default() } else { DIM })
    };
    let total: u64 = view.total.iter().sum();
    let share = (total > 0).then(|| view.total[0] as f64 / total as f64);
    let mut spans = vec![
        Span::raw("   forecasts  "),
        quality(learned, "learned", Color::Green),
        quality(held, "held", Color::Yellow),
        quality(kinematic, "kinematic", Color::Yellow),
    ];
    if view.total_shed > 0 {
        let share = percent((total > 0).then(|| view.total_shed as f64 / total as f64));
        let text = format!("{} shed, {} so far   ", view.newest_shed, share.trim());
        let style = if view.newest_shed > 0 { Color::Yellow.on_default() } else { DIM };
        spans.push(Span::styled(text, style));
    }
    if view.newest_outside > 0 {
        spans.push(quality(view.newest_outside, "never trained", Color::Yellow));
    }
    let mut so_far = format!("{} so far, {} learned", count(total), percent(share));
    if view.total_outdone > 0 {
        so_far += &format!(", {} constant velocity", percent(Some(view.total_outdone as f64 / total as f64)));
    }
    spans.push(Span::styled(so_far, DIM));
    [Line::default(), Line(spans), worth(view)]
}

/// The errors of forecasts whose horizon has passed.
fn worth(view: &LiveView) -> Line {
    let label = Span::raw("   matured    ");
    let Some(errors) = view.errors.as_ref().filter(|errors| errors.forecasts > 0) else {
        return Line(vec![label, Span::styled("none yet", DIM)]);
    };
    let held = [errors.held_50, errors.held_90].map(|share| percent(share).trim().to_owned());
    let regions = format!("regions of 50 % held {}, 90 % {}   ", held[0], held[1]);
    let [ours, steady] = [errors.single_ade_m, errors.cv_ade_m].map(number);
    let single = format!("ADE {ours} m, CV {steady} m");
    Line(vec![label, Span::raw(regions), Span::styled(single, DIM)])
}
