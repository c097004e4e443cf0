use console::screen::{BOLD, Color, DIM, Line, Span, TITLE, curve};
use recorder::Status;
use recorder::report::Percentiles;
use recorder::text::{count, number, percent};
use wire::vocabulary::{LOOKS, Look};

use super::View;
use super::columns::{Row, WORST, bar_width, cut, heading, line, section, share_spans, worst};

/// Maximum number of lines for events and for worst ticks.
const EVENTS_MAX: usize = 4;
const WORST_MAX: usize = 5;
/// Cells in the curve's line that are not part of the curve.
const CURVE_MARGIN: usize = 28;

impl View {
    /// Returns the view in at most `height` lines, without keys.
    pub fn table(&self, width: usize, height: usize) -> Vec<Line> {
        let mut lines = lines(self, width);
        truncate(&mut lines, height);
        lines
    }

    /// Returns the view as a screen of this size, with a line of keys at the bottom.
    pub fn screen(&self, width: usize, height: usize) -> Vec<Line> {
        screen(self, width, height)
    }
}

/// Formats the view as plain text.
pub fn text(view: &View, width: usize) -> String {
    let lines = lines(view, width);
    let text: String =
        lines.iter().map(|line| line.paint(width, false).trim_end().to_owned() + "\n").collect();
    text.trim_end().to_owned() + "\n"
}

/// Returns the view in at most `height` lines, with a line of keys at the bottom.
pub fn screen(view: &View, width: usize, height: usize) -> Vec<Line> {
    let mut lines = lines(view, width);
    let room = height.saturating_sub(1);
    truncate(&mut lines, room);
    lines.resize(room, Line::default());
    lines.push(keys_line(view));
    lines.truncate(height);
    lines
}

/// Removes the lines that have no room, and headings without content.
pub fn truncate(lines: &mut Vec<Line>, room: usize) {
    if lines.len() > room {
        lines.truncate(room);
        while lines.last().is_some_and(|line| line.width() == 0 || is_heading_of_worst(line)) {
            lines.pop();
        }
    }
}

/// Returns all lines of the view.
pub fn lines(view: &View, width: usize) -> Vec<Line> {
    let mut lines = vec![title(view, width)];
    lines.extend(verdict(view, width));
    lines.push(Line::default());
    lines.push(latency(view, width));
    lines.extend(latency_curve(view, width));
    lines.extend(quality(view));
    lines.extend(noise(view, width));
    lines.push(Line::default());
    if let Some(name) = &view.stage {
        lines.extend(super::stage::lines(view, name, width));
        return lines;
    }
    lines.push(heading(width));
    for (place, stage) in view.stages().into_iter().enumerate() {
        let row = Row { stage, report: view.of_report(stage) };
        lines.push(line(row, width, place == view.selected));
    }
    lines.push(Line::styled(note(view, width), DIM));
    lines.extend(refusals(view, width));
    lines.extend(events(view, width));
    lines.extend(worst(&view.status.report.worst_ticks, width, WORST_MAX));
    lines
}

fn note(view: &View, width: usize) -> String {
    let seconds = match view.status.recent_ticks {
        125.. => "the last 10 s".to_owned(),
        ticks => format!("the last {ticks} ticks"),
    };
    match width {
        100.. => format!(
            "  ms of {seconds}: compute p50, p99, max; waiting, wake-up and sending at p99. lost, rst (restarts): whole run"
        ),
        _ => format!("  ms of {seconds}: compute; wait, wake at p99. lost, rst: whole run"),
    }
}

/// The run's name on the left and its progress on the right.
fn title(view: &View, width: usize) -> Line {
    let status = &view.status;
    let tick = match status.ticks_limit {
        Some(limit) => format!("tick {} of {}", count(status.report.ticks), count(limit)),
        None => format!("tick {}", count(status.report.ticks)),
    };
    let (minutes, seconds) = ((status.elapsed_s / 60.0) as u64, status.elapsed_s % 60.0);
    let right = format!("{tick}   {minutes:02}:{seconds:04.1}");
    let left = format!(" {}  {}", status.run, status.title);
    let room = width.saturating_sub(right.chars().count() + 10);
    let left: String = left.chars().take(room).collect();
    let gap = room.saturating_sub(left.chars().count()) + 1;
    Line(vec![
        Span::styled(" stgdat ", TITLE),
        Span::raw(left),
        Span::raw(" ".repeat(gap)),
        Span::styled(right, BOLD),
    ])
}

/// Describes whether the run is healthy and, if not, why.
fn verdict(view: &View, width: usize) -> Vec<Line> {
    let status = &view.status;
    let (name, colour) = match status.report.verdict.status {
        _ if view.silent => ("NO ANSWER".into(), Color::Red),
        _ if !status.linked => (status.before_begin(), Color::Yellow),
        Status::Ok => (Status::Ok.name().into(), Color::Green),
        Status::Empty => ("NO FORECASTS".into(), Color::Yellow),
        other => (other.name().into(), Color::Yellow),
    };
    let paused = if view.paused { "  (paused)" } else { "" };
    let reasons = if view.silent {
        vec!["the launcher does not answer; the table shows its last answer".to_owned()]
    } else if status.linked && status.report.verdict.status == Status::Ok {
        status.report.ok_lines()
    } else {
        status.report.verdict.reasons.clone()
    };
    let mut lines = vec![Line(vec![
        Span::raw(" "),
        Span::styled(format!("{name:12}"), colour.on_default().bold()),
        Span::raw(cut(reasons.first().map_or("", String::as_str), width.saturating_sub(13 + paused.len()))),
        Span::styled(paused, Color::Cyan.on_default().bold()),
    ])];
    for reason in reasons.iter().skip(1).take(3) {
        lines.push(Line::raw(format!("{:13}{}", "", cut(reason, width.saturating_sub(13)))));
    }
    lines
}

/// End-to-end latency against the limit, now and over the whole run.
fn latency(view: &View, width: usize) -> Line {
    let status = &view.status;
    let limit_ms = status.report.late_limit_ms;
    let recent = &status.recent_end_to_end_ms;
    let mut spans = vec![
        Span::styled(" end to end", BOLD),
        Span::raw(format!("{:>6}{:>6}{:>6}", number(recent.p50), number(recent.p99), number(recent.max))),
        Span::styled(format!("{:>7}", limit_ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms}"))), DIM),
    ];
    let cells = bar_width(width);
    spans.extend(share_spans(recent.p99.zip(limit_ms).map(|(p99, limit)| p99 / limit), cells));
    let late = status.report.late_ticks;
    let style = if late > 0 { Color::Red.on_default().bold() } else { DIM };
    spans.push(Span::styled(format!("   late {}", count(late)), style));
    let dead = status.report.supervision.dead_readers;
    if dead > 0 {
        spans.push(Span::raw(format!("   dead readers {}", count(dead))));
    }
    let lines: u64 = status.report.supervision.lost_lines.values().sum();
    if lines > 0 {
        spans.push(Span::colored(format!("   lines lost {}", count(lines)), Color::Yellow));
    }
    if width >= 100 {
        let Percentiles { p50, p99, max, .. } = status.report.end_to_end_ms;
        let whole = format!("   whole run {} / {} / {}", number(p50), number(p99), number(max));
        spans.push(Span::styled(whole, DIM));
    }
    Line(spans)
}

/// The latency of the newest ticks, newest right. The height of the curve is the limit, halved as long as all
/// latencies fit. Small latencies therefore fill the curve too.
fn latency_curve(view: &View, width: usize) -> Option<Line> {
    let (all, limit_ms) = (&view.status.recent_latencies_ms, view.status.report.late_limit_ms?);
    let newest_us: Vec<u64> = all.iter().rev().map(|latency_ms| (latency_ms * 1e3) as u64).collect();
    let (&most_us, limit_us) = (newest_us.iter().max()?, (limit_ms * 1e3) as u64);
    let mut height_us = limit_us;
    while height_us / 2 > most_us && height_us > 2_000 {
        height_us /= 2;
    }
    let cells = newest_us.len().min(width.saturating_sub(CURVE_MARGIN));
    let color = if most_us > limit_us { Color::Red } else { Color::Cyan };
    Some(Line(vec![
        Span::raw(format!("{:13}", "")),
        Span::colored(curve(&newest_us, height_us, cells, 1).concat(), color),
        Span::styled(format!("  of {} ms", number(Some(height_us as f64 / 1e3))), DIM),
    ]))
}

/// The noise of the detections, as the tracker has learned it.
fn noise(view: &View, width: usize) -> Option<Line> {
    let words = cut(&view.status.report.input.noise_line()?, width.saturating_sub(13));
    Some(Line(vec![Span::styled(" noise       ", BOLD), Span::raw(words)]))
}

/// The look of a cause by its name; `None` for a cause of a newer version.
fn look(cause: &str) -> Option<&'static Look> {
    LOOKS.iter().find(|look| look.cause.name() == cause)
}

/// Shares of forecast qualities with causes, and the coverage.
fn quality(view: &View) -> Vec<Line> {
    let status = &view.status;
    let forecasts = &status.report.forecasts;
    let total: u64 = forecasts.by_quality().iter().map(|(_, n)| n).sum();
    let mut now = vec![Span::styled(" forecasts   ", BOLD)];
    let causes = || status.newest.causes.iter().map(|(cause, count)| (look(cause), cause, *count));
    let is_fault = |look: Option<&Look>| look.is_none_or(|look| !look.is_normal);
    let has_faults = causes().any(|(look, ..)| is_fault(look));
    for (name, all) in forecasts.by_quality() {
        let newest = status.newest.qualities.get(name).copied().unwrap_or(0);
        let colour = if has_faults && name != "learned" { Color::Yellow } else { Color::Green };
        let style = if newest > 0 { colour.on_default() } else { DIM };
        now.push(Span::styled(format!("{newest} {name} "), style));
        let share = percent((total > 0).then(|| all as f64 / total as f64));
        now.push(Span::styled(format!("({share})  "), DIM));
    }
    for (place, (look, cause, count)) in causes().enumerate() {
        let comma = if place > 0 { ", " } else { "" };
        let text = format!("{comma}{} {count}", look.map_or(cause.as_str(), |look| look.words));
        now.push(if is_fault(look) { Span::colored(text, Color::Yellow) } else { Span::raw(text) });
    }
    if forecasts.shed.forecasts > 0 {
        let share = percent(forecasts.shed.share);
        now.push(Span::styled(format!("  shed {} so far", share.trim()), DIM));
    }
    if status.newest.outside > 0 {
        now.push(Span::colored(format!("  never trained {}", status.newest.outside), Color::Yellow));
    }
    let mut worth = vec![Span::styled(" regions     ", BOLD)];
    match &status.accuracy {
        Some(errors) if errors.held_50.is_some() => {
            let held =
                format!("of 50 % held {}, of 90 % held {}", percent(errors.held_50), percent(errors.held_90));
            worth.push(Span::raw(held));
            let ade = format!("   minADE {} m, CV {}", number(errors.ade_m), number(errors.cv_ade_m));
            worth.push(Span::styled(ade, DIM));
        }
        _ => worth.push(Span::styled("no truth has covered a horizon yet", DIM)),
    }
    vec![Line(now), Line(worth)]
}

fn refusals(view: &View, width: usize) -> Vec<Line> {
    let refused = view.status.report.refusals.iter().take(EVENTS_MAX);
    let lines = refused.map(|refused| {
        let text = format!(
            "  refused   {} of the {} by the {}: {}",
            count(refused.frames),
            refused.sender,
            refused.reader,
            refused.cause
        );
        Line::colored(cut(&text, width), Color::Red)
    });
    section(lines.collect())
}

fn events(view: &View, width: usize) -> Vec<Line> {
    let newest = view.status.events.iter().rev().take(EVENTS_MAX);
    let lines = newest.map(|event| {
        let text = format!("  {:>7.1} s  {}", event.elapsed_s, event.text);
        Line::colored(cut(&text, width), Color::Yellow)
    });
    section(lines.collect())
}

fn is_heading_of_worst(line: &Line) -> bool {
    line.0.first().is_some_and(|span| span.text.trim_start().starts_with(WORST))
}

fn keys_line(view: &View) -> Line {
    let key = |key: &'static str| Span::styled(key, Color::Cyan.on_default().bold());
    let mut spans = vec![key("  q"), Span::raw(" quit  "), key("p"), Span::raw(" pause  ")];
    if view.stage.is_some() {
        spans.extend([key("↑↓"), Span::raw(" other stage  "), key("esc"), Span::raw(" all stages")]);
    } else {
        spans.extend([key("s"), Span::raw(format!(" sort: {}  ", view.sort.name()))]);
        spans.extend([key("↑↓"), Span::raw(" select  "), key("enter"), Span::raw(" one stage")]);
    }
    Line(spans)
}
