//! The kinds of the forecasts and their errors.

use std::fmt::{self, Write};

use wire::Cause;
use wire::vocabulary::words_of;

use super::{ALL_PHASES_WIDTH, LABEL_WIDTH, fact, trimmed};
use crate::report::{Errors, Report, Shed};
use crate::text::{bar, count, number, percent, subscript};
use crate::tick::is_fault;

impl Report {
    pub(super) fn forecasts(&self, text: &mut String, width: usize) -> fmt::Result {
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
                " {:LABEL_WIDTH$}{silent:>10}   omitted: no learned forecast for longer than the policy allows",
                "silent"
            )?;
        }
        let mut causes: Vec<_> = forecasts.causes.iter().filter(|&(_, &n)| n > 0).collect();
        causes.sort_by_key(|&(_, &n)| std::cmp::Reverse(n));
        causes.iter().try_for_each(|&(cause, &n)| {
            // Only faults count as "not learned", here as in the verdict.
            let is_excused = Cause::ALL.into_iter().any(|known| known.name() == cause && !is_fault(known));
            let kind = if is_excused { "kinematic" } else { "not learned" };
            writeln!(text, " {:LABEL_WIDTH$}{:>10}   {kind}: {}", "", count(n), words_of(cause))
        })
    }

    pub(super) fn accuracy(&self, text: &mut String, width: usize) -> fmt::Result {
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
                "the 50 % region held {} of the ends, the 90 % region {}",
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
