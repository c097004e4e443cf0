//! The report as text for a terminal.

mod pace;

use std::fmt::{self, Write};

use wire::Cause;

use crate::input::DOUBT;
use crate::report::{
    Errors, Outage, Percentiles, RefusedFrames, Replacement, ReplacementOutcome, Report, Shed, SpareReport,
    StageMemory, StageReport, Status, Supervision, WorstTick,
};
use crate::text::{bar, count, number, percent, subscript};
use crate::tick::is_fault;

/// Smallest and largest width of the report's lines.
const WIDTHS: std::ops::RangeInclusive<usize> = 80..=120;
/// Width from which the stages' table shows every phase.
const ALL_PHASES_WIDTH: usize = 96;
const LABEL_WIDTH: usize = 12;
/// Largest number of rows of refusals. The JSON contains all.
const ROWS_MAX: usize = 8;
/// Number of worst ticks listed for a run without late ticks.
const SLOWEST_LEN: usize = 3;

impl Report {
    /// The report as plain text for lines of `width` characters, limited to 80 to 120.
    #[must_use]
    pub fn render(&self, width: usize) -> String {
        let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
        let mut text = String::new();
        let write = |text: &mut String| -> fmt::Result {
            self.headline(text, width)?;
            self.facts(text)?;
            self.input(text, width)?;
            if self.ticks > 0 {
                self.latency(text, width)?;
            }
            self.stages(text, width)?;
            self.forecasts(text, width)?;
            self.refusals(text)?;
            self.supervision(text)?;
            self.replacements(text)?;
            self.spares(text)?;
            self.readers(text)?;
            self.memory(text, width)?;
            self.worst_ticks(text, width)?;
            self.accuracy(text, width)
        };
        write(&mut text).expect("writing to a string can't fail");
        text
    }

    fn headline(&self, text: &mut String, width: usize) -> fmt::Result {
        let rule = "─".repeat(width);
        writeln!(text, "{rule}")?;
        match self.verdict.status {
            Status::Ok => {
                writeln!(text, " OK          {}", self.ok_lines().join("\n             "))?;
            }
            Status::Doubtful => {
                writeln!(text, " DOUBTFUL    {}", self.reason_lines(width).join("\n             "))?;
            }
            Status::Degraded => {
                writeln!(text, " DEGRADED    {}", self.reason_lines(width).join("\n             "))?;
                for line in self.too_slow().into_iter().flatten() {
                    writeln!(text, "             {line}")?;
                }
            }
            Status::Empty => {
                writeln!(text, " EMPTY       no agent was forecast")?;
                for reason in self.reason_lines(width) {
                    writeln!(text, "             {reason}")?;
                }
            }
        }
        writeln!(text, "{rule}")
    }

    /// The reasons of the verdict. Doubts about the input are wrapped.
    fn reason_lines(&self, width: usize) -> Vec<String> {
        let lines = |reason: &String| match reason.starts_with(DOUBT) {
            true => wrapped(reason, width - LABEL_WIDTH - 2),
            false => vec![reason.clone()],
        };
        self.verdict.reasons.iter().flat_map(lines).collect()
    }

    /// The content of the input, and the findings that are not doubts.
    fn input(&self, text: &mut String, width: usize) -> fmt::Result {
        let notes = self.input.findings.iter().filter(|found| !found.doubtful).map(ToString::to_string);
        for (place, words) in self.input.line().into_iter().chain(notes).enumerate() {
            for (row, line) in wrapped(&words, width - LABEL_WIDTH - 2).into_iter().enumerate() {
                fact(text, if place + row == 0 { "input" } else { "" }, &[Some(line)])?;
            }
        }
        Ok(())
    }

    fn facts(&self, text: &mut String) -> fmt::Result {
        let run = &self.run;
        if let Some(recording) = &run.recording {
            // The name of a generated scene contains its agents and seed.
            let seed = run.seed.filter(|_| run.scene_agents.is_none()).map(|seed| format!("seed {seed}"));
            fact(text, "recording", &[Some(recording.clone()), seed])?;
        }
        if run.weights.is_some() || run.weights_sha256.is_some() {
            let hash = run.weights_sha256.as_ref().map(|hash| hash.chars().take(12).collect());
            let seen = run.seen_in_training.map(|seen| match seen {
                true => "trained on this recording: errors are optimistic".to_owned(),
                false => "not trained on this recording".to_owned(),
            });
            fact(text, "weights", &[run.weights.clone(), hash, seen])?;
            let restricted: Vec<&str> = run.non_commercial_data().collect();
            if !restricted.is_empty() {
                let data = format!("trained on data for non-commercial use: {}", restricted.join(", "));
                fact(text, "licence", &[Some(data)])?;
            }
        }
        if let Some(precision) = &run.precision {
            fact(text, "precision", &[Some(precision.clone())])?;
        }
        if let Some(retrieval) = run.retrieval {
            let memory = match run.memory_entries.filter(|&len| len > 0) {
                _ if !retrieval => "off".to_owned(),
                Some(len) => format!("warm-started with {} entries of earlier runs", count(len)),
                None => "online, began empty".to_owned(),
            };
            fact(text, "retrieval", &[Some(memory)])?;
        }
        let rate = run.interval_ms.map(|ms| format!("{} Hz", trimmed(1e3 / ms)));
        let thinned = run.thinned_by.filter(|&n| n > 1).map(|n| format!("1 frame in {n} of the recording"));
        let time = run.played_s.zip(run.elapsed_s).map(|(played_s, elapsed_s)| match run.lockstep {
            Some(true) => format!("{played_s:.1} s in {elapsed_s:.1} s, lockstep"),
            _ => format!("{played_s:.1} s"),
        });
        fact(text, "played", &[Some(format!("{} ticks", count(self.ticks))), rate, time, thinned])?;
        if let (Some(mean), Some(max)) = (self.agents.mean, self.agents.max) {
            fact(text, "agents", &[Some(format!("{mean:.1} per tick, at most {max}"))])?;
        }
        if let Some(line) = self.lanes.line() {
            fact(text, "lanes", &[Some(line)])?;
        }
        Ok(())
    }

    fn latency(&self, text: &mut String, width: usize) -> fmt::Result {
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
        let note = if self.run.lockstep == Some(true) { " (lockstep: no deadline)" } else { "" };
        writeln!(
            text,
            " {:LABEL_WIDTH$}{:>8} of {}{note}",
            "late ticks",
            count(self.late_ticks),
            count(self.ticks)
        )
    }

    fn stages(&self, text: &mut String, width: usize) -> fmt::Result {
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
        self.stages.iter().try_for_each(|stage| stage_row(text, stage, all, cells))?;
        let publish = if all { ", publish" } else { "" };
        writeln!(
            text,
            " {:LABEL_WIDTH$}waiting, wake-up{publish}: ms at p99; over: ticks over budget; lost: frames",
            ""
        )
    }

    fn forecasts(&self, text: &mut String, width: usize) -> fmt::Result {
        let forecasts = &self.forecasts;
        let total = forecasts.learned + forecasts.held + forecasts.kinematic;
        if total == 0 {
            return Ok(());
        }
        let cells = (width - 60).min(24);
        writeln!(text, "\n {:LABEL_WIDTH$}{:>10}", "FORECASTS", count(total))?;
        let age = forecasts.age_ms_max.map(|age_ms| format!("at most {} ms old", trimmed(age_ms)));
        let rows = [
            ("learned", forecasts.learned, None),
            ("held", forecasts.held, age),
            ("kinematic", forecasts.kinematic, None),
        ];
        for (name, n, note) in rows {
            let share = n as f64 / total as f64;
            let (bar, percent) = (bar(share, cells), percent(Some(share)));
            let note = note.map_or_else(String::new, |note| format!("  {note}"));
            writeln!(text, " {name:LABEL_WIDTH$}{:>10}{percent:>9}   {bar}{note}", count(n))?;
        }
        let priors = &self.priors;
        let of_priors = [("learned", priors.learned), ("held", priors.held), ("kinematic", priors.kinematic)];
        let sum: u64 = of_priors.iter().map(|(_, n)| n).sum();
        let share =
            |(name, n): (&str, u64)| format!("{name} {}", percent(Some(n as f64 / sum.max(1) as f64)));
        fact(text, "prior", &of_priors.map(|prior| (prior.1 > 0).then(|| share(prior))))?;
        let outside = &self.out_of_distribution;
        if let (Some(speed_mps), Some(most)) = (outside.speed_mps_max, outside.measure_max) {
            let share = percent(Some(outside.forecasts as f64 / total as f64));
            let (at_most, most) = (trimmed(speed_mps), trimmed(most));
            writeln!(
                text,
                " {:LABEL_WIDTH$}{:>10}{share:>9}   never trained: speeds to {at_most} m/s, measure to {most}",
                "outside",
                count(outside.forecasts)
            )?;
        }
        if forecasts.shed.forecasts > 0 {
            let Shed { forecasts: shed, ticks, share, agents_max, age_ms_max } = forecasts.shed;
            let age = age_ms_max.map_or_else(String::new, |ms| format!(", at most {} ms old", trimmed(ms)));
            writeln!(
                text,
                " {:LABEL_WIDTH$}{:>10}{:>9}   no time: in {} ticks, at most {agents_max} agents{age}",
                "shed",
                count(shed),
                percent(share),
                count(ticks),
            )?;
        }
        if forecasts.silent > 0 {
            let silent = count(forecasts.silent);
            writeln!(
                text,
                " {:LABEL_WIDTH$}{silent:>10}   not said: no learned forecast for longer than the policy allows",
                "silent"
            )?;
        }
        let mut causes: Vec<_> = forecasts.causes.iter().filter(|&(_, &n)| n > 0).collect();
        causes.sort_by_key(|&(_, &n)| std::cmp::Reverse(n));
        causes.iter().try_for_each(|&(cause, &n)| {
            // Only faults count as "not learned", here as in the verdict.
            let is_excused = Cause::ALL.into_iter().any(|known| known.name() == cause && !is_fault(known));
            let kind = if is_excused { "kinematic" } else { "not learned" };
            writeln!(text, " {:LABEL_WIDTH$}{:>10}   {kind}: {}", "", count(n), meaning(cause))
        })
    }

    fn refusals(&self, text: &mut String) -> fmt::Result {
        if !self.refusals.is_empty() {
            writeln!(text, "\n REFUSED")?;
        }
        self.refusals.iter().take(ROWS_MAX).try_for_each(|refused| {
            let (frames, RefusedFrames { reader, sender, cause, .. }) = (count(refused.frames), refused);
            let frames = if refused.frames == 1 { "1 frame".to_owned() } else { format!("{frames} frames") };
            writeln!(text, " {sender:LABEL_WIDTH$}{frames} refused by the {reader}: {}", why(cause))
        })
    }

    fn supervision(&self, text: &mut String) -> fmt::Result {
        let supervision = &self.supervision;
        if supervision.outages.is_empty() && supervision.starved.is_empty() {
            return Ok(());
        }
        writeln!(text, "\n {:LABEL_WIDTH$}", "OUTAGES")?;
        for outage in &supervision.outages {
            let again = match outage.ticks_to_learned {
                Some(0) => "without effect on the forecasts".to_owned(),
                Some(ticks) => format!("learned again after {} ticks", count(ticks)),
                None => "not learned again by the end".to_owned(),
            };
            let lost = [
                (outage.ticks_lost, "lost"),
                (outage.ticks_not_learned, "not learned"),
                (outage.ticks_predicted, "predicted"),
            ];
            let lost = lost.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!(", {n} {what}"));
            let (stage, tick, cause) = (&outage.stage, count(outage.tick), &outage.cause);
            let by = if outage.by_spare { ", spare promoted" } else { "" };
            let lost = lost.collect::<String>();
            writeln!(text, " {stage:LABEL_WIDTH$}tick {tick}: {cause}{by}; {again}{lost}")?;
        }
        if supervision.outages_unlisted > 0 {
            let more = count(supervision.outages_unlisted);
            writeln!(text, " {:LABEL_WIDTH$}and {more} more", "")?;
        }
        for (stage, times) in &supervision.starved {
            let times = count(*times);
            writeln!(text, " {stage:LABEL_WIDTH$}got no CPU for longer than its limit, {times} times")?;
        }
        Ok(())
    }

    /// Page faults of the stages, locked memory, and settings that were not allowed.
    fn memory(&self, text: &mut String, width: usize) -> fmt::Result {
        let Supervision { memory, notes, .. } = &self.supervision;
        for (i, note) in notes.iter().enumerate() {
            let heading = if i == 0 { "\n NOT ALLOWED" } else { " " };
            writeln!(text, "{heading:w$}{note}", w = LABEL_WIDTH + if i == 0 { 2 } else { 1 })?;
        }
        if memory.is_empty() {
            return Ok(());
        }
        let ticks = memory.values().map(|stage| stage.ticks).max().unwrap_or(0);
        let faulty = memory.iter().filter(|(_, stage)| stage.minor_faults + stage.major_faults > 0);
        let mut faults: Vec<String> = faulty
            .map(|(name, stage)| match stage.major_faults {
                0 => format!("{name} {}", count(stage.minor_faults)),
                major => format!("{name} {} and {} that read", count(stage.minor_faults), count(major)),
            })
            .collect();
        let last = faults.len().saturating_sub(1);
        faults.iter_mut().take(last).for_each(|part| part.push(','));
        let ticks = count(ticks);
        let mut line = format!(" {:LABEL_WIDTH$}page faults in the last {ticks} ticks:", "MEMORY");
        writeln!(text)?;
        for part in if faults.is_empty() { vec!["none".to_owned()] } else { faults } {
            if line.chars().count() + part.len() + 1 > width {
                writeln!(text, "{line}")?;
                line = format!(" {:LABEL_WIDTH$}", "");
                line.pop();
            }
            line = format!("{line} {part}");
        }
        writeln!(text, "{line}")?;
        let sum = |of: fn(&StageMemory) -> u64| memory.values().map(of).sum::<u64>() >> 10;
        let (resident, locked) = (sum(|stage| stage.resident_kib), sum(|stage| stage.locked_kib));
        let locked = match locked {
            _ if locked == resident => "all locked".to_owned(),
            _ => format!("{locked} MiB locked, the rest is over ulimit -l"),
        };
        fact(text, "", &[Some(format!("{resident} MiB resident")), Some(locked)])
    }

    /// Late and degraded ticks, and ticks without forecasts. If the run had none, the slowest few.
    fn worst_ticks(&self, text: &mut String, width: usize) -> fmt::Result {
        let is_lockstep = self.run.lockstep == Some(true);
        let is_late = |tick: &WorstTick| {
            !is_lockstep && tick.end_to_end_ms.zip(self.late_limit_ms).is_some_and(|(ms, limit)| ms > limit)
        };
        let is_bad = |tick: &&WorstTick| tick.ticks_lost > 0 || tick.not_learned > 0 || is_late(tick);
        let bad: Vec<&WorstTick> = self.worst_ticks.iter().filter(is_bad).collect();
        let (name, rows) = match bad.is_empty() {
            true => ("SLOWEST", self.worst_ticks.iter().take(SLOWEST_LEN).collect()),
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

    fn replacements(&self, text: &mut String) -> fmt::Result {
        if !self.supervision.replacements.is_empty() {
            writeln!(text, "\n {:LABEL_WIDTH$}", "REPLACED")?;
        }
        self.supervision.replacements.iter().try_for_each(|replacement| {
            let Replacement { outcome, outage, .. } = replacement;
            let Outage { stage, tick, cause, ticks_lost, ticks_not_learned, ticks_to_learned, .. } = outage;
            let (program, tick) = (replacement.program(), count(*tick));
            let warm =
                replacement.warm_up_ms.map_or_else(String::new, |ms| format!(", warm after {ms:.0} ms"));
            let over = replacement
                .hand_over_ms
                .map_or_else(String::new, |ms| format!(", handed over in {ms:.0} ms"));
            let ticks = || {
                let again = ticks_to_learned.map_or_else(
                    || "not learned again by the end".to_owned(),
                    |ticks| format!("learned again after {}", count(ticks)),
                );
                format!(
                    "ticks: {} lost, {} not learned, {again}",
                    count(*ticks_lost),
                    count(*ticks_not_learned)
                )
            };
            let came = match outcome {
                ReplacementOutcome::Replaced => format!("by {program}{warm}{over}; {}", ticks()),
                ReplacementOutcome::NotUsed => format!("not by {program}: it {cause}; the old one went on"),
                ReplacementOutcome::RolledBack => {
                    format!("rolled back from {program}: it {cause}; {}", ticks())
                }
            };
            writeln!(text, " {stage:LABEL_WIDTH$}tick {tick}: {came}")
        })
    }

    /// The actions of each spare, and the memory of all spares.
    fn spares(&self, text: &mut String) -> fmt::Result {
        let spares = &self.supervision.spares;
        if spares.is_empty() {
            return Ok(());
        }
        let sum = |of: fn(&SpareReport) -> u64| spares.values().map(of).sum::<u64>() >> 10;
        let (own, shared) = (sum(|spare| spare.memory_kib), sum(|spare| spare.shared_kib));
        writeln!(text, "\n {:LABEL_WIDTH$}{own} MiB of their own, {shared} MiB shared", "SPARES")?;
        spares.iter().try_for_each(|(stage, spare)| {
            let times = |what: &str, times: u32| match times {
                0 => String::new(),
                1 => format!(", {what} once"),
                times => format!(", {what} {times} times"),
            };
            let warm = spare.warm_up_ms.map_or_else(String::new, |ms| format!(", warm after {ms:.0} ms"));
            let (promoted, died) = (times("promoted", spare.promotions), times("died waiting", spare.deaths));
            writeln!(text, " {stage:LABEL_WIDTH$}{}{warm}{promoted}{died}", spare.state)
        })
    }

    /// The readers that died.
    fn readers(&self, text: &mut String) -> fmt::Result {
        let dead = match self.supervision.dead_readers {
            0 => return Ok(()),
            1 => "1 reader of topics has died: its places were given back".to_owned(),
            dead => format!("{} readers of topics have died: their places were given back", count(dead)),
        };
        writeln!(text, "\n {:LABEL_WIDTH$}{dead}", "READERS")
    }

    fn accuracy(&self, text: &mut String, width: usize) -> fmt::Result {
        let accuracy = &self.accuracy;
        let (Some(draws), Some(horizon_s)) = (accuracy.draws, accuracy.horizon_s) else {
            return match self.ticks {
                0 => Ok(()),
                _ => writeln!(text, "\n ACCURACY    unknown: no truth covers the horizon of any forecast"),
            };
        };
        let group = if width >= ALL_PHASES_WIDTH { 22 } else { 18 };
        let modes = format!("K = {draws} modes");
        writeln!(
            text,
            "\n {:LABEL_WIDTH$}{:>10}{modes:>group$}{:>group$}{:>group$}",
            "ACCURACY m", "forecasts", "single best", "const. velocity"
        )?;
        let column = group / 2;
        let pair = |ade: &str, fde: &str| format!("{ade:>w$}{fde:>column$}", w = group - column);
        let k = subscript(draws);
        let best = pair(&format!("minADE{k}"), &format!("minFDE{k}"));
        let single = pair("ADE", "FDE");
        writeln!(text, " {:LABEL_WIDTH$}{:>10}{best}{single}{single}", "", "")?;
        let row = |text: &mut String, name: &str, errors: &Errors| {
            write!(text, " {name:LABEL_WIDTH$}{:>10}", count(errors.forecasts))?;
            let pairs = [
                (errors.ade_m, errors.fde_m),
                (errors.single_ade_m, errors.single_fde_m),
                (errors.cv_ade_m, errors.cv_fde_m),
            ];
            for (ade_m, fde_m) in pairs {
                write!(text, "{:>w$}{:>column$}", number(ade_m), number(fde_m), w = group - column)?;
            }
            writeln!(text)
        };
        row(text, "all", &accuracy.errors)?;
        accuracy.by_type.iter().try_for_each(|(name, errors)| row(text, name, errors))?;
        row(text, "learned", &accuracy.learned)?;
        let misses =
            [accuracy.errors.miss_rate, accuracy.errors.single_miss_rate, accuracy.errors.cv_miss_rate];
        write!(text, " {:LABEL_WIDTH$}{:>10}", "miss rate", format!("> {} m", accuracy.miss_radius_m))?;
        misses.iter().try_for_each(|&share| write!(text, "{:>group$}", percent(share)))?;
        writeln!(text)?;
        if let (Some(half), Some(most)) = (accuracy.errors.held_50, accuracy.errors.held_90) {
            let held = format!(
                "of the ends, {} lay in the region of 50 % and {} in that of 90 %",
                percent(Some(half)).trim(),
                percent(Some(most)).trim()
            );
            fact(text, "regions", &[Some(held)])?;
        }
        let uncovered = format!("{} without complete truth", count(accuracy.uncovered));
        let unmatched = format!("{} without a match", count(accuracy.unmatched));
        fact(text, "horizon", &[Some(format!("{horizon_s:.1} s"))])?;
        fact(text, "not scored", &[Some(uncovered), Some(unmatched)])
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

/// `label  part · part`, without the unknown parts.
fn fact(text: &mut String, label: &str, parts: &[Option<String>]) -> fmt::Result {
    let known: Vec<&str> = parts.iter().flatten().map(String::as_str).collect();
    writeln!(text, " {label:LABEL_WIDTH$}{}", known.join(" · "))
}

/// A sentence in lines of at most `width` characters, if its words allow this.
fn wrapped(sentence: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in sentence.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// At most two decimals, without trailing zeros.
fn trimmed(value: f64) -> String {
    let fixed = format!("{value:.2}");
    fixed.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The cause of a refusal in words.
fn why(cause: &str) -> &str {
    match cause {
        "schema" => "of another version",
        "foreign run" => "of another run",
        "old incarnation" => "of a process that had been replaced",
        "size" => "sizes that can't be",
        "value" => "numbers that can't be",
        "order" => "stamps or elements out of order",
        "check value" => "header or payload changed on the way",
        "unprotected" => "no check value: see `protect` in docs/integrity.md",
        "repeated" => "came again, or too late",
        other => other,
    }
}

/// A cause in words.
fn meaning(cause: &str) -> &str {
    match cause {
        "late" => "the controls arrived too late",
        "rejected" => "the controls were refused",
        "missing" => "there are no controls for the track",
        "young" => "the track's history is too short",
        "outdone" => "constant velocity proved better",
        "shed" => "the tick had no time for all agents",
        other => other,
    }
}

#[cfg(test)]
mod tests;
