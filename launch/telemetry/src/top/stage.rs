//! The view of a single stage.

use console::screen::{BOLD, Color, DIM, Line, Span};
use recorder::report::Percentiles;
use recorder::status::StageStatus;
use recorder::text::{count, number};

use super::View;
use super::columns::{bytes, cut, share_spans, worst};

/// Maximum number of displayed worst ticks of the stage.
const WORST_MAX: usize = 8;

/// Formats all data of a stage.
pub fn lines(view: &View, name: &str, width: usize) -> Vec<Line> {
    let Some(stage) = view.status.stages.iter().find(|stage| stage.name == name) else {
        return vec![Line::colored(format!("  there is no stage {name} any more"), Color::Red)];
    };
    let mut lines = process(view, stage, width);
    lines.push(Line::default());
    lines.extend(phases(view, stage, width));
    lines.push(Line::default());
    lines.extend(losses(view, stage, width));
    let own: Vec<_> = view
        .status
        .report
        .worst_ticks
        .iter()
        .filter(|tick| tick.stage.as_deref() == Some(name))
        .cloned()
        .collect();
    lines.extend(worst(&own, width, WORST_MAX));
    lines
}

/// The state and resources of the process, wrapped to `width`.
fn process(view: &View, stage: &StageStatus, width: usize) -> Vec<Line> {
    let process = &stage.process;
    let item = |name: &str, value: Option<String>| {
        vec![Span::styled(format!("   {name} "), DIM), Span::raw(value.unwrap_or_else(|| "–".to_owned()))]
    };
    let alive = match stage.alive {
        Some(true) => Span::colored("alive", Color::Green),
        Some(false) => Span::styled("no heartbeat", Color::Red.on_default().bold()),
        None => Span::styled("no heartbeat yet", DIM),
    };
    let mut items = vec![
        item("pid", process.pid.map(|pid| pid.to_string())),
        item("restarts", Some(process.restarts.to_string())),
        item("cpu", process.cpu.map(|cpu| format!("{:.0} %", cpu * 1e2))),
        item("memory", process.memory_bytes.map(|own| bytes(Some(own)).0)),
        item("shared", process.shared_bytes.map(|shared| bytes(Some(shared)).0)),
    ];
    if let Some(spare) = &process.spare {
        items.push(item("spare", Some(format!("{spare}, promoted {}×", process.promotions))));
    }
    if let Some(&lost) = view.status.report.supervision.lost_lines.get(&stage.name) {
        items.push(item("lines lost", Some(count(lost))));
    }
    let mut lines = vec![Line(vec![
        Span::styled(format!("  {}  ", stage.name), BOLD),
        Span::raw(format!("{}, ", process.state)),
        alive,
    ])];
    for item in items {
        let item = Line(item);
        match lines.last_mut() {
            Some(last) if last.width() + item.width() <= width => last.0.extend(item.0),
            _ => lines.push(item),
        }
    }
    lines
}

fn phases(view: &View, stage: &StageStatus, width: usize) -> Vec<Line> {
    let whole = view.of_report(stage);
    let heading = format!(
        "  {:12}{:>8}{:>8}{:>8}{:>14}{:>8}{:>8}",
        "ms", "p50", "p99", "max", "whole: p50", "p99", "max"
    );
    let rows = [
        ("waiting", stage.recent_waiting_ms, whole.map(|whole| whole.waiting_ms)),
        ("wake-up", stage.recent_wake_up_ms, whole.map(|whole| whole.wake_up_ms)),
        ("compute", stage.recent_compute_ms, whole.map(|whole| whole.compute_ms)),
        ("publish", stage.recent_publish_ms, whole.map(|whole| whole.publish_ms)),
    ];
    let row = |(name, recent, whole): (&str, Percentiles, Option<Percentiles>)| {
        let whole = whole.unwrap_or_default();
        let text = format!(
            "  {name:12}{:>8}{:>8}{:>8}{:>14}{:>8}{:>8}",
            number(recent.p50),
            number(recent.p99),
            number(recent.max),
            number(whole.p50),
            number(whole.p99),
            number(whole.max)
        );
        let mut spans = vec![Span::raw(text)];
        if name == "compute"
            && let Some(budget_ms) = stage.budget_ms
            && width >= 100
        {
            spans.extend(share_spans(recent.p99.map(|p99| p99 / budget_ms), 12));
            spans.push(Span::styled(format!(" of {budget_ms} ms"), DIM));
        }
        Line(spans)
    };
    std::iter::once(Line::styled(heading, DIM)).chain(rows.map(row)).collect()
}

fn losses(view: &View, stage: &StageStatus, width: usize) -> Vec<Line> {
    let mut lines = Vec::new();
    if let Some(report) = view.of_report(stage) {
        let drops = report.drops;
        let counts = [
            ("over budget", report.late_ticks),
            ("gaps", drops.gap),
            ("refused", drops.refused),
            ("lost by restart", drops.restart),
        ];
        let mut spans = vec![Span::raw(format!("  {} ticks", count(report.ticks)))];
        for (name, value) in counts {
            let style = if value > 0 { Color::Red.on_default().bold() } else { DIM };
            spans.push(Span::styled(format!("   {name} {}", count(value)), style));
        }
        lines.push(Line(spans));
    }
    if let Some(behind) = stage.behind_ticks.filter(|&ticks| ticks > 2) {
        let text = format!("  {} ticks behind the newest forecasts", count(behind));
        lines.push(Line::styled(text, Color::Red.on_default().bold()));
    }
    if let Some(counts) = view.status.report.link_line(&stage.name) {
        lines.push(Line::raw(cut(&format!("  link: {counts}"), width)));
    }
    for refused in &view.status.report.refusals {
        if refused.reader == stage.name || refused.sender == stage.name {
            let text = format!(
                "  {} frames of the {} refused by the {}: {}",
                count(refused.frames),
                refused.sender,
                refused.reader,
                refused.cause
            );
            lines.push(Line::styled(cut(&text, width), Color::Red.on_default()));
        }
    }
    lines
}
