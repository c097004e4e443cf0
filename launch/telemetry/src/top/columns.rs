//! The columns of the table of stages.

use console::screen::{BOLD, Color, DIM, Line, Span, Style};
use recorder::report::{StageReport, WorstTick};
use recorder::status::StageStatus;
use recorder::text::{bar, count, number};

/// Minimum and maximum number of cells of a budget bar.
const BAR_WIDTHS: [usize; 2] = [5, 24];

/// One row: the stage's current status and its report for the whole run.
#[derive(Clone, Copy)]
pub struct Row<'a> {
    pub stage: &'a StageStatus,
    pub report: Option<&'a StageReport>,
}

/// A column.
struct Column {
    head: &'static str,
    width: usize,
    /// Minimum terminal width at which the column is shown.
    from_width: usize,
    cell: fn(Row<'_>) -> (String, Style),
}

/// Formats the time of a phase.
fn time(value: Option<f64>) -> (String, Style) {
    (number(value), Style::new())
}

fn fault(value: u64) -> (String, Style) {
    (count(value), if value > 0 { Color::Red.on_default().bold() } else { DIM })
}

/// The columns in display order. The budget bar follows the first `BUDGET` columns.
const COLUMNS: [Column; 17] = [
    Column { head: "p50", width: 6, from_width: 0, cell: |row| time(row.stage.recent_compute_ms.p50) },
    Column { head: "p99", width: 6, from_width: 0, cell: |row| time(row.stage.recent_compute_ms.p99) },
    Column { head: "max", width: 6, from_width: 0, cell: |row| time(row.stage.recent_compute_ms.max) },
    Column {
        head: "budget",
        width: 7,
        from_width: 0,
        cell: |row| (row.stage.budget_ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms}")), DIM),
    },
    Column { head: "wait", width: 6, from_width: 0, cell: |row| time(row.stage.recent_waiting_ms.p99) },
    Column { head: "wake", width: 6, from_width: 0, cell: |row| time(row.stage.recent_wake_up_ms.p99) },
    Column { head: "send", width: 6, from_width: 100, cell: |row| time(row.stage.recent_publish_ms.p99) },
    Column {
        head: "over",
        width: 6,
        from_width: 100,
        cell: |row| fault(row.report.map_or(0, |report| report.late_ticks)),
    },
    Column {
        head: "lost",
        width: 5,
        from_width: 0,
        cell: |row| fault(row.report.map_or(0, |report| report.drops.total())),
    },
    Column {
        head: "gap",
        width: 5,
        from_width: 130,
        cell: |row| fault(row.report.map_or(0, |report| report.drops.gap)),
    },
    Column {
        head: "refus",
        width: 6,
        from_width: 130,
        cell: |row| fault(row.report.map_or(0, |report| report.drops.refused)),
    },
    Column { head: "behind", width: 7, from_width: 130, cell: behind },
    Column { head: "rst", width: 4, from_width: 0, cell: |row| fault(row.stage.process.restarts.into()) },
    Column { head: "cpu", width: 5, from_width: 0, cell: cpu },
    Column { head: "mem", width: 6, from_width: 0, cell: |row| bytes(row.stage.process.memory_bytes) },
    Column { head: "shared", width: 7, from_width: 130, cell: |row| bytes(row.stage.process.shared_bytes) },
    Column { head: "spare", width: 9, from_width: 140, cell: spare },
];
/// Number of columns before the bar.
const BUDGET: usize = 4;
/// Cells of a stage's name with its marker.
const NAME: usize = 11;

fn behind(row: Row<'_>) -> (String, Style) {
    match row.stage.behind_ticks {
        None => ("–".to_owned(), DIM),
        // A heartbeat may be up to one tick old.
        Some(ticks @ 0..=2) => (count(ticks), DIM),
        Some(ticks) => (count(ticks), Color::Red.on_default().bold()),
    }
}

fn spare(row: Row<'_>) -> (String, Style) {
    match row.stage.process.spare.as_deref() {
        None => ("–".to_owned(), DIM),
        Some("ready") => ("ready".to_owned(), Color::Green.on_default()),
        Some(state) => (state.to_owned(), Color::Yellow.on_default()),
    }
}

fn cpu(row: Row<'_>) -> (String, Style) {
    let text = row.stage.process.cpu.map_or_else(|| "–".to_owned(), |cpu| format!("{:.0}%", cpu * 1e2));
    (text, Style::new())
}

/// Formats bytes with three digits and a unit.
pub fn bytes(value: Option<u64>) -> (String, Style) {
    let Some(value) = value else { return ("–".to_owned(), DIM) };
    let mib = value as f64 / f64::from(1 << 20);
    let text = match mib {
        _ if mib < 9.95 => format!("{mib:.1}M"),
        _ if mib < 999.5 => format!("{mib:.0}M"),
        _ => format!("{:.1}G", mib / 1024.0),
    };
    (text, Style::new())
}

/// Returns the width of the budget bar in a terminal of `width` cells.
pub fn bar_width(width: usize) -> usize {
    let taken: usize = shown(width).map(|(_, column)| column.width).sum();
    width.saturating_sub(NAME + taken + 6).clamp(BAR_WIDTHS[0], BAR_WIDTHS[1])
}

fn shown(width: usize) -> impl Iterator<Item = (usize, &'static Column)> {
    COLUMNS.iter().enumerate().filter(move |(_, column)| width >= column.from_width)
}

/// The table's heading.
pub fn heading(width: usize) -> Line {
    let mut text = format!("  {:1$}", "stage", NAME - 2);
    for (nth, column) in shown(width) {
        if nth == BUDGET {
            text += &format!(" {:1$}", "p99 of it", bar_width(width) + 5);
        }
        text += &format!("{:>1$}", column.head, column.width);
    }
    Line::styled(text, DIM)
}

/// The line of a stage.
pub fn line(row: Row<'_>, width: usize, is_selected: bool) -> Line {
    let process = &row.stage.process;
    let (mark, colour) = match (row.stage.alive, process.state.as_str()) {
        (_, "given up") => ("✖", Color::Red),
        (_, "restarting") => ("↻", Color::Yellow),
        (_, "ended") => ("○", Color::BrightBlack),
        (None, _) => ("○", Color::BrightBlack),
        (Some(true), _) => ("●", Color::Green),
        (Some(false), _) => ("●", Color::Red),
    };
    let name = if is_selected { BOLD.invert() } else { Style::new() };
    let mut spans = vec![
        Span::colored(format!("{mark} "), colour),
        Span::styled(format!("{:1$}", row.stage.name, NAME - 2), name),
    ];
    for (nth, column) in shown(width) {
        if nth == BUDGET {
            let share = row.stage.recent_compute_ms.p99.zip(row.stage.budget_ms);
            spans.extend(share_spans(share.map(|(p99, budget)| p99 / budget), bar_width(width)));
        }
        let (text, style) = (column.cell)(row);
        spans.push(Span::styled(format!("{text:>0$}", column.width), style));
    }
    Line(spans)
}

/// Formats a share as a bar and a number.
pub fn share_spans(share: Option<f64>, cells: usize) -> [Span; 2] {
    let colour = match share {
        None => Color::BrightBlack,
        Some(share) if share > 1.0 => Color::Red,
        Some(share) if share > 0.75 => Color::Yellow,
        Some(_) => Color::Green,
    };
    let filled = share.map_or_else(|| " ".repeat(cells), |share| bar(share, cells));
    let percent = share.map_or_else(String::new, |share| format!("{:.0}%", (share * 1e2).min(9_999.0)));
    [Span::colored(format!(" {filled}"), colour), Span::raw(format!("{percent:>5}"))]
}

/// Heading of the worst ticks.
pub const WORST: &str = "worst tick";

/// The worst ticks with their causes.
pub fn worst(ticks: &[WorstTick], width: usize, most: usize) -> Vec<Line> {
    let mut lines: Vec<Line> = ticks
        .iter()
        .take(most)
        .map(|tick| {
            let (number_of, time) = (count(tick.tick), number(tick.end_to_end_ms));
            Line(vec![
                Span::raw(format!("  {number_of:>10}{time:>8}   ")),
                Span::raw(cut(&tick.cause, width.saturating_sub(23))),
            ])
        })
        .collect();
    if !lines.is_empty() {
        lines.insert(0, Line::styled(format!("  {WORST:>10}{:>8}   why", "ms"), DIM));
    }
    section(lines)
}

/// Returns the lines with an empty line before them.
pub fn section(mut lines: Vec<Line>) -> Vec<Line> {
    if !lines.is_empty() {
        lines.insert(0, Line::default());
    }
    lines
}

/// Cuts a text to `width` characters, with an ellipsis if it was longer.
pub fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    text.chars().take(width.saturating_sub(1)).chain(['…']).collect()
}
