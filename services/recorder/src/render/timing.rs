//! The times of ticks and stages.

use std::fmt::{self, Write};

use super::{ALL_PHASES_WIDTH, LABEL_WIDTH, trimmed, wrapped};
use crate::report::{Percentiles, Report, StageReport, WorstTick};
use crate::text::{bar, count, number, percent};

/// Number of worst ticks listed for a run without late ticks.
const SLOWEST_COUNT: usize = 3;

impl Report {
    pub(super) fn latency(&self, text: &mut String, width: usize) -> fmt::Result {
        let p999 = self.end_to_end_ms.p999.is_some();
        let heading = if p999 { "    p99.9" } else { "" };
        writeln!(text, "\n {:LABEL_WIDTH$}{:>8}{:>9}{heading}{:>9}", "LATENCY ms", "p50", "p99", "max")?;
        let row = |text: &mut String, name: &str, times: &Percentiles| {
            write!(text, " {name:LABEL_WIDTH$}{:>8}{:>9}", number(times.p50), number(times.p99))?;
            if p999 {
                write!(text, "{:>9}", number(times.p999))?;
            }
            write!(text, "{:>9}", number(times.max))
        };
        row(text, "end to end", &self.end_to_end_ms)?;
        if let (Some(p99), Some(limit_ms)) = (self.end_to_end_ms.p99, self.late_limit_ms) {
            let share = p99 / limit_ms;
            let cells = (width - 72).min(24);
            let limit = trimmed(limit_ms);
            write!(text, "   {} p99 is {} of {limit} ms", bar(share, cells), percent(Some(share)))?;
        }
        writeln!(text)?;
        row(text, "overhead", &self.overhead_ms)?;
        writeln!(text, "   end to end less compute")?;
        if self.since_stamp_ms.p50.is_some() {
            row(text, "since stamp", &self.since_stamp_ms)?;
            writeln!(text, "   from the sensor's stamp to the forecasts, by its clock")?;
        }
        let note = if self.run.lockstep == Some(true) { " (lockstep: no deadline)" } else { "" };
        writeln!(
            text,
            " {:LABEL_WIDTH$}{:>8} of {}{note}",
            "late ticks",
            count(self.late_ticks),
            count(self.ticks)
        )
    }

    pub(super) fn stages(&self, text: &mut String, width: usize) -> fmt::Result {
        if self.stages.is_empty() {
            return Ok(());
        }
        let all = width >= ALL_PHASES_WIDTH;
        let cells = (if all { width - 86 } else { width - 71 }).min(24);
        let (max, publish) = if all { ("    max", " publish") } else { ("", "") };
        writeln!(
            text,
            "\n {:LABEL_WIDTH$}    p50    p99{max} budget  {:bars$} waiting wake-up{publish}  over  lost",
            "COMPUTE ms",
            "p99 of budget",
            bars = cells + 7,
        )?;
        let mut rows = self.stages.iter().filter(|stage| stage.is_measured() || stage.program.is_empty());
        rows.try_for_each(|stage| stage_row(text, stage, all, cells))?;
        let publish = if all { ", publish" } else { "" };
        writeln!(
            text,
            " {:LABEL_WIDTH$}waiting, wake-up{publish}: ms at p99; over: ticks over budget; lost: frames",
            ""
        )
    }

    pub(super) fn worst_ticks(&self, text: &mut String, width: usize) -> fmt::Result {
        let is_lockstep = self.run.lockstep == Some(true);
        let is_late = |tick: &WorstTick| {
            !is_lockstep && tick.end_to_end_ms.zip(self.late_limit_ms).is_some_and(|(ms, limit)| ms > limit)
        };
        let is_bad = |tick: &&WorstTick| tick.ticks_lost > 0 || tick.not_learned > 0 || is_late(tick);
        let bad: Vec<&WorstTick> = self.worst_ticks.iter().filter(is_bad).collect();
        let (name, rows) = match bad.is_empty() {
            true => ("SLOWEST", self.worst_ticks.iter().take(SLOWEST_COUNT).collect()),
            false => ("WORST TICKS", bad),
        };
        if rows.is_empty() {
            return Ok(());
        }
        writeln!(text, "\n {name:LABEL_WIDTH$}{:>9}{:>9}", "tick", "ms")?;
        for tick in rows {
            let mut lines = wrapped(&tick.cause, width - LABEL_WIDTH - 22).into_iter();
            let first = lines.next().unwrap_or_default();
            let (number_of, time) = (count(tick.tick), number(tick.end_to_end_ms));
            writeln!(text, " {:LABEL_WIDTH$}{number_of:>9}{time:>9}   {first}", "")?;
            for line in lines {
                writeln!(text, " {:LABEL_WIDTH$}{:>9}{:>9}   {line}", "", "", "")?;
            }
        }
        Ok(())
    }
}

fn stage_row(text: &mut String, stage: &StageReport, all: bool, cells: usize) -> fmt::Result {
    let StageReport { compute_ms, waiting_ms, wake_up_ms, publish_ms, .. } = stage;
    write!(text, " {:LABEL_WIDTH$}{:>7}{:>7}", stage.name, number(compute_ms.p50), number(compute_ms.p99))?;
    if all {
        write!(text, "{:>7}", number(compute_ms.max))?;
    }
    let budget = stage.budget_ms.map_or_else(|| "–".to_owned(), trimmed);
    let filled = stage.budget_share_p99.map_or_else(|| " ".repeat(cells), |share| bar(share, cells));
    write!(text, "{budget:>7}  {filled}{:>7}", percent(stage.budget_share_p99))?;
    write!(text, "{:>8}{:>8}", number(waiting_ms.p99), number(wake_up_ms.p99))?;
    if all {
        write!(text, "{:>8}", number(publish_ms.p99))?;
    }
    write!(text, "{:>6}{:>6}", narrow(stage.late_ticks), narrow(stage.drops.total()))?;
    if stage.restarts > 0 {
        write!(text, "  restarted {}×", stage.restarts)?;
    }
    if stage.replacements > 0 {
        write!(text, "  replaced {}×", stage.replacements)?;
    }
    writeln!(text)
}

/// A count below a million in at most five characters.
fn narrow(n: u64) -> String {
    if n < 10_000 { count(n) } else { format!("{} k", n / 1_000) }
}
