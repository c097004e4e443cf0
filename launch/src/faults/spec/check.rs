//! Converts the text of a specification to its meaning.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::config::{Mistake, Pipeline, SourceError};
use ports::Point;
use run::TopicRun;
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use wire::{RefusalCause, StageId, TABLE};

use super::table::{At, Expect, FaultTable, File, Process, TopicTable};
use super::{Fault, RunSpec, Spec, Target, When};
use crate::failure::Failure;
use crate::faults::effect::{Effect, TopicFault};
use crate::stages::declared;

/// Causes for which a stage counts lost frames.
const COUNTERS: [&str; 3] = ["gap", "refused", "restart"];
/// Threads per core of a CPU fault, enough to leave a stage only a small share.
const HOGS_PER_CORE: usize = 8;

impl Spec {
    /// Reads and checks a specification.
    ///
    /// # Errors
    /// [`Failure::Source`] points to the first place in the text that is wrong.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text =
            std::fs::read_to_string(path).map_err(|error| Failure::config_about(path.display(), error))?;
        Ok(Self::parse(path, &text)?)
    }

    /// Checks the text of a specification.
    pub fn parse(path: &Path, text: &str) -> Result<Self, SourceError> {
        read(path, text).map_err(|mistake| mistake.at(&path.display().to_string(), text))
    }
}

fn read(path: &Path, text: &str) -> Result<Spec, Mistake> {
    let syntax = |error| Mistake::syntax(text, &error);
    let mut table = DeTable::parse(text).map_err(syntax)?;
    let faults = table.get_mut().remove("fault");
    let file = File::deserialize(toml::Deserializer::from(table)).map_err(syntax)?;
    let faults = match faults.map(|faults| (faults.span(), faults.into_inner())) {
        None => Vec::new(),
        Some((_, DeValue::Array(faults))) => {
            faults.into_iter().map(FaultTable::read).collect::<Result<_, _>>()?
        }
        Some((span, _)) => return Err(Mistake::new(span, "`fault` is not a list", "expected [[fault]]")),
    };
    check(path, file, &faults)
}

fn check(path: &Path, file: File, tables: &[Spanned<FaultTable>]) -> Result<Spec, Mistake> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let ticks = *file.run.ticks.get_ref();
    if ticks == 0 {
        return Err(Mistake::new(
            file.run.ticks.span(),
            "`ticks` = 0: a run without ticks",
            "expected 1 or more",
        ));
    }
    let beside = |path: PathBuf| if path.is_absolute() { path } else { folder.join(path) };
    let pipeline = file.run.pipeline.map(|path| {
        let span = path.span();
        (beside(path.into_inner()), span)
    });
    let (added, topics) =
        pipeline.as_ref().map_or(Ok(Default::default()), |(path, span)| added_to_pipeline(path, span))?;
    let mut run = RunSpec {
        stages: BTreeMap::new(),
        added,
        topics,
        ticks,
        agents: file.run.agents,
        recording: file.run.recording.map(beside),
        seed: file.run.seed,
        pipeline: pipeline.map(|(path, _)| path),
        forecasts: file.run.forecasts.map(beside),
        protect: file.run.protect,
        arguments: file.run.arguments,
    };
    for (name, keys) in file.run.stages {
        known_stage(name.get_ref(), name.span(), &run)?;
        run.stages.insert(name.into_inner(), keys);
    }
    let faults = tables.iter().map(|table| fault(table, &run)).collect::<Result<Vec<_>, _>>()?;
    for (i, table) in tables.iter().enumerate() {
        not_mixed(table, &faults[i], &faults[..i])?;
    }
    expectations(&file.expect, &run)?;
    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(Spec { name, path: path.to_owned(), shows: file.shows, run, faults, expect: file.expect })
}

/// Returns the stages that a pipeline.toml adds and the topics that it declares. This process knows the names
/// from now on.
fn added_to_pipeline(path: &Path, span: &Range<usize>) -> Result<(Vec<String>, Vec<TopicRun>), Mistake> {
    let refused = |why: String| {
        Mistake::new(span.clone(), format!("`pipeline`: {why}"), "expected a pipeline.toml that can be used")
    };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| refused(format!("{name}: {error}")))?;
    let pipeline = Pipeline::parse(&name, &text, &declared()).map_err(|error| refused(error.to_string()))?;
    pipeline.name_stages();
    let added = pipeline.stages.iter().filter(|stage| stage.id.is_added());
    let added = added.map(|stage| stage.id.name().to_owned()).collect();
    Ok((added, pipeline.topics))
}

/// Each entry of a stage's points applies to one process in turn. A kill by signal in between would consume
/// an entry.
fn not_mixed(table: &Spanned<FaultTable>, fault: &Fault, earlier: &[Fault]) -> Result<(), Mistake> {
    let of = |fault: &Fault| match fault {
        Fault::KillAt { stage, .. } => Some((*stage, true)),
        Fault::Kill { target: Target::Stage(stage), .. }
        | Fault::Stop { target: Target::Stage(stage), .. } => Some((*stage, false)),
        _ => None,
    };
    let Some((stage, at_point)) = of(fault) else { return Ok(()) };
    if earlier.iter().filter_map(of).any(|(other, point)| other == stage && point != at_point) {
        let message = format!("the {} is killed at a point and by signals in one run", stage.name());
        return Err(Mistake::new(table.span(), message, "make it a specification of its own"));
    }
    Ok(())
}

fn fault(table: &Spanned<FaultTable>, run: &RunSpec) -> Result<Fault, Mistake> {
    let process = match table.get_ref() {
        FaultTable::Topic(of, effect) => return of_topic(of, *effect, run).map(Fault::Topic),
        FaultTable::Process(process) => process,
    };
    Ok(match process {
        Process::Kill { stage, at, after_start_ms, within_ms, point } => {
            let target = target(stage, run)?;
            let when = match (within_ms, at, after_start_ms, point) {
                (Some(ms), None, None, None) => When::Within { ms: within(ms)? },
                (None, None, Some(ms), None) => When::AfterStart { ms: *ms },
                (None, Some(at), None, None) => When::Ticks(ticks(at, run)?),
                (None, Some(at), None, Some(point)) => {
                    let stage = self::stage(stage, run)?;
                    let (point, ticks) = (known_point(stage, point)?, ticks(at, run)?);
                    return Ok(Fault::KillAt { stage, point, ticks });
                }
                _ => {
                    let label = "needs `at`, alone or with a `point`, `after_start_ms` or `within_ms`";
                    return Err(Mistake::new(table.span(), "when does it kill?", label));
                }
            };
            Fault::Kill { target, when }
        }
        Process::Random { ticks, count, stages, for_ms } => Fault::Random {
            stages: random(stages.as_ref(), run)?,
            ticks: range(ticks, run)?,
            count: *count,
            stop_ms: *for_ms,
        },
        Process::Stop { stage, at, for_ms } => {
            Fault::Stop { target: target(stage, run)?, ticks: ticks(at, run)?, for_ms: *for_ms }
        }
        Process::Limit { stage, at, resource, value } => Fault::Limit {
            stage: self::stage(stage, run)?,
            tick: tick(at, run)?,
            resource: *resource,
            value: *value,
        },
        Process::CrashLoop { stage, at, exit_code } => Fault::CrashLoop {
            stage: self::stage(stage, run)?,
            tick: tick(at, run)?,
            exit_code: exit_code.unwrap_or(3),
        },
        Process::Command { stage, command } => {
            Fault::Command { stage: self::stage(stage, run)?, command: self::command(command)? }
        }
        Process::Replace { stage, at, command, point } => {
            let stage = self::stage(stage, run)?;
            if let (Some(command), Some(_)) = (command, point) {
                let label = "without it the new process is the built-in one, which has points";
                return Err(Mistake::new(command.span(), "`command` and `point` exclude each other", label));
            }
            Fault::Replace {
                stage,
                ticks: ticks(at, run)?,
                command: command.as_ref().map(self::command).transpose()?,
                point: point.as_ref().map(|point| known_point(stage, point)).transpose()?,
            }
        }
        Process::Cpu { at, for_ms, threads } => {
            let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
            let threads = threads.unwrap_or(HOGS_PER_CORE * cores);
            Fault::Cpu { tick: tick(at, run)?, for_ms: *for_ms, threads }
        }
        Process::Consumer { topic, hold_ms, within_ms } => Fault::Consumer {
            topic: self::topic(topic, run)?,
            hold_ms: *hold_ms,
            within_ms: within_ms.as_ref().map(within).transpose()?,
        },
    })
}

/// The shortest and the longest time until a death.
fn within(within: &Spanned<[u64; 2]>) -> Result<[u64; 2], Mistake> {
    let ms = *within.get_ref();
    if ms[0] < ms[1] {
        return Ok(ms);
    }
    let message = format!("`within_ms` = {ms:?}");
    Err(Mistake::new(within.span(), message, "expected [shortest, longest]"))
}

/// The stages of a random fault; all stages if none are named.
fn random(stages: Option<&Spanned<Vec<String>>>, run: &RunSpec) -> Result<Vec<StageId>, Mistake> {
    let Some(names) = stages else { return Ok(run.stages().map(|(stage, _)| stage).collect()) };
    if names.get_ref().is_empty() {
        return Err(Mistake::new(names.span(), "`stages` is empty", "expected names of stages"));
    }
    names.get_ref().iter().map(|name| known_stage(name, names.span(), run)).collect()
}

/// The range of ticks in which a fault may act.
fn range(ticks: &Spanned<[u64; 2]>, run: &RunSpec) -> Result<[u64; 2], Mistake> {
    let [first, last] = *ticks.get_ref();
    if first > last || last >= run.ticks {
        let message = format!("`ticks` = [{first}, {last}] of a run of {} ticks", run.ticks);
        let label = format!("expected 0 ≤ first ≤ last < {}", run.ticks);
        return Err(Mistake::new(ticks.span(), message, label));
    }
    Ok([first, last])
}

/// Returns the point if the stage has it.
fn known_point(stage: StageId, point: &Spanned<String>) -> Result<Point, Mistake> {
    let name = point.get_ref();
    let found = Point::from_name(name).ok_or_else(|| {
        let label = format!("expected one of {}", Point::ALL.map(Point::name).join(", "));
        Mistake::new(point.span(), format!("unknown point \"{name}\" of a stage's step"), label)
    })?;
    if stage == StageId::Recorder && found != Point::Idle {
        let message = format!("the recorder has no point \"{name}\": it sends nothing");
        return Err(Mistake::new(point.span(), message, "it has \"idle\" alone"));
    }
    Ok(found)
}

fn command(command: &Spanned<Vec<String>>) -> Result<Vec<String>, Mistake> {
    if command.get_ref().is_empty() {
        return Err(Mistake::new(command.span(), "`command` is empty", "expected [\"program\", …]"));
    }
    Ok(command.get_ref().clone())
}

fn of_topic(table: &TopicTable, effect: Effect, run: &RunSpec) -> Result<TopicFault, Mistake> {
    let ticks = range(&table.ticks, run)?;
    if let Some(chance) = table
        .probability
        .as_ref()
        .filter(|chance| !(0.0..=1.0).contains(chance.get_ref()) || *chance.get_ref() == 0.0)
    {
        let message = format!("`probability` = {}", chance.get_ref());
        return Err(Mistake::new(chance.span(), message, "expected more than 0, at most 1"));
    }
    let probability = table.probability.as_ref().map_or(1.0, |chance| *chance.get_ref());
    let topic = topic(&table.topic, run)?;
    let has_fields = |topic: &TopicRun| TABLE.topics.iter().any(|known| known.type_name == topic.type_name);
    let unknown = run.topics.iter().find(|declared| declared.name == topic && !has_fields(declared));
    if let (Some(unknown), Effect::NotFinite {} | Effect::Huge {}) = (unknown, effect) {
        let (kind, unknown) = (effect.name(), &unknown.type_name);
        let message = format!("\"{kind}\" on \"{topic}\": the fields of \"{unknown}\" are not known");
        let label = "expected a topic whose numbers are known; a \"bit-flip\" needs no fields";
        return Err(Mistake::new(table.topic.span(), message, label));
    }
    Ok(TopicFault { topic, effect, ticks, probability, seed: table.seed.unwrap_or(run.seed) })
}

fn ticks(at: &Spanned<At>, run: &RunSpec) -> Result<Vec<u64>, Mistake> {
    let ticks = match at.get_ref() {
        At::One(tick) => vec![*tick],
        At::Many(ticks) => ticks.clone(),
    };
    if ticks.is_empty() || !ticks.is_sorted_by(|a, b| a < b) {
        let label = "expected ticks, each after the one before";
        return Err(Mistake::new(at.span(), format!("`at` = {ticks:?}"), label));
    }
    match ticks.last() {
        Some(last) if *last >= run.ticks => {
            let message = format!("`at` = {last} of a run of {} ticks", run.ticks);
            Err(Mistake::new(at.span(), message, format!("expected less than {}", run.ticks)))
        }
        _ => Ok(ticks),
    }
}

fn tick(at: &Spanned<At>, run: &RunSpec) -> Result<u64, Mistake> {
    match &ticks(at, run)?[..] {
        [tick] => Ok(*tick),
        more => {
            let label = "expected a single tick for this kind of fault";
            Err(Mistake::new(at.span(), format!("`at` = {more:?}"), label))
        }
    }
}

fn target(name: &Spanned<String>, run: &RunSpec) -> Result<Target, Mistake> {
    if name.get_ref() == "launcher" { Ok(Target::Launcher) } else { stage(name, run).map(Target::Stage) }
}

fn stage(name: &Spanned<String>, run: &RunSpec) -> Result<StageId, Mistake> {
    known_stage(name.get_ref(), name.span(), run)
}

fn known_stage(name: &str, span: Range<usize>, run: &RunSpec) -> Result<StageId, Mistake> {
    run.stage(name).ok_or_else(|| {
        let known: Vec<&str> = run.stages().map(|(_, name)| name).collect();
        let label = format!("expected one of {}", known.join(", "));
        Mistake::new(span, format!("unknown stage \"{name}\""), label)
    })
}

fn topic(name: &Spanned<String>, run: &RunSpec) -> Result<String, Mistake> {
    let shipped = TABLE.topics.iter().filter(|topic| topic.publishers_max == 1).map(|topic| topic.name);
    let topics: Vec<&str> = shipped.chain(run.topics.iter().map(|topic| topic.name.as_str())).collect();
    if topics.contains(&name.get_ref().as_str()) {
        return Ok(name.get_ref().clone());
    }
    let label = format!("expected one of {}", topics.join(", "));
    Err(Mistake::new(name.span(), format!("unknown topic \"{}\"", name.get_ref()), label))
}

/// Checks the names in the block of expectations, whose values have no spans in the text.
fn expectations(expect: &Expect, run: &RunSpec) -> Result<(), Mistake> {
    let stages = expect.outages.iter().map(|outages| &outages.stage);
    let stages = stages.chain(expect.counted.iter().map(|counted| &counted.stage)).chain(&expect.given_up);
    let stages = stages.chain(expect.replacements.iter().map(|replaced| &replaced.stage));
    let stages = stages.chain(expect.promotions.keys());
    let mut starved = expect.starved.iter().filter(|name| *name != "any");
    if let Some(name) = stages.chain(&mut starved).find(|name| run.stage(name).is_none()) {
        let known: Vec<&str> = run.stages().map(|(_, name)| name).collect();
        let label = format!("in `[expect]`; the stages are {}", known.join(", "));
        return Err(Mistake::new(0..0, format!("unknown stage \"{name}\""), label));
    }
    for counted in &expect.counted {
        let refusals = || RefusalCause::ALL.into_iter().map(RefusalCause::name);
        if !COUNTERS.into_iter().chain(refusals()).any(|known| known == counted.cause) {
            let known: Vec<&str> = COUNTERS.into_iter().chain(refusals()).collect();
            let label = format!("in `[[expect.counted]]`; the causes are {}", known.join(", "));
            return Err(Mistake::new(0..0, format!("unknown cause \"{}\"", counted.cause), label));
        }
        if counted.as_injected.is_none() && counted.min.is_none() && counted.max.is_none() {
            let label = "in `[[expect.counted]]`: set `as_injected`, `min` or `max`";
            return Err(Mistake::new(
                0..0,
                format!("nothing is expected of the {}'s count", counted.stage),
                label,
            ));
        }
        let is_known = |kind: &&String| Effect::NAMES.contains(&kind.as_str());
        if let Some(kind) = counted.as_injected.as_ref().filter(|kind| !is_known(kind)) {
            let label = format!("in `[[expect.counted]]`; the kinds are {}", Effect::NAMES.join(", "));
            return Err(Mistake::new(0..0, format!("unknown kind of fault \"{kind}\""), label));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
