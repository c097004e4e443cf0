//! The report as text for a terminal.

mod pace;
mod quality;
mod timing;

use std::fmt::{self, Write};

use crate::input::DOUBT;
use crate::report::{
    Outage, RefusedFrames, Replacement, ReplacementOutcome, Report, SceneNoise, SpareReport, StageMemory,
    Status, Supervision,
};
use crate::text::count;

/// Smallest and largest width of the report's lines.
const WIDTHS: std::ops::RangeInclusive<usize> = 80..=120;
/// Width from which the stages' table shows every phase.
const ALL_PHASES_WIDTH: usize = 96;
const LABEL_WIDTH: usize = 12;
/// Largest number of rows of refusals. The JSON contains all.
const ROWS_MAX: usize = 8;

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
            self.links(text, width)?;
            self.supervision(text)?;
            self.replacements(text)?;
            self.spares(text)?;
            self.readers(text)?;
            self.losses_of_the_launcher(text)?;
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
        self.input.noise_line().map_or(Ok(()), |noise| fact(text, "noise", &[Some(noise)]))
    }

    fn facts(&self, text: &mut String) -> fmt::Result {
        let run = &self.run;
        if let Some(recording) = &run.recording {
            // The name of a generated scene contains its agents and seed.
            let seed = run.seed.filter(|_| run.scene_agents.is_none()).map(|seed| format!("seed {seed}"));
            fact(text, "recording", &[Some(recording.clone()), seed])?;
        }
        if let Some(noise) = run.scene_noise {
            fact(text, "scene", &[Some(noise.line())])?;
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

    /// The counts of links to other boxes.
    fn links(&self, text: &mut String, width: usize) -> fmt::Result {
        if !self.links.is_empty() {
            writeln!(text, "\n LINKS")?;
        }
        for (stage, line) in self.links.keys().filter_map(|stage| Some((stage, self.link_line(stage)?))) {
            for (row, line) in wrapped(&line, width - LABEL_WIDTH - 2).into_iter().enumerate() {
                fact(text, if row == 0 { stage } else { "" }, &[Some(line)])?;
            }
        }
        Ok(())
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
                ReplacementOutcome::NotUsed => format!("not by {program}: it {cause}; the old one continues"),
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

    /// The lines that are missing in the log, and the processes that were left behind.
    fn losses_of_the_launcher(&self, text: &mut String) -> fmt::Result {
        let Supervision { lost_lines, not_ended, .. } = &self.supervision;
        if !lost_lines.is_empty() {
            let lines: Vec<String> =
                lost_lines.iter().map(|(origin, lines)| format!("{origin} {}", count(*lines))).collect();
            writeln!(text, "\n {:LABEL_WIDTH$}missing lines: {}", "LOG", lines.join(", "))?;
        }
        if !not_ended.is_empty() {
            let all: Vec<String> =
                not_ended.iter().map(|(stage, pid)| format!("{stage} (process {pid})")).collect();
            writeln!(
                text,
                "\n {:LABEL_WIDTH$}left behind, could not be killed: {}",
                "PROCESSES",
                all.join(", ")
            )?;
        }
        Ok(())
    }
}

impl SceneNoise {
    /// The noise in words.
    pub fn line(&self) -> String {
        let [least_m, most_m] =
            [(f64::INFINITY, f64::min as fn(f64, f64) -> f64), (0.0, f64::max as fn(f64, f64) -> f64)]
                .map(|(first, of)| self.position_m.into_iter().fold(first, of));
        let heading = trimmed(self.heading_deg);
        match (trimmed(least_m), trimmed(most_m)) {
            _ if most_m == 0.0 => "generated, without detector noise".to_owned(),
            (least, most) if least == most => {
                format!("generated, detector noise {most} m, headings {heading}°")
            }
            (least, most) => {
                format!("generated, detector noise {least} to {most} m by type, headings {heading}°")
            }
        }
    }
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
        "size" => "impossible sizes",
        "value" => "impossible numbers",
        "order" => "stamps or elements out of order",
        "check value" => "header or payload changed on the way",
        "unprotected" => "no check value: see `protect` in docs/integrity.md",
        "repeated" => "repeated, or too late",
        other => other,
    }
}

#[cfg(test)]
mod tests;
