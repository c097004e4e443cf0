//! Converts the text of a specification to its meaning.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use configuration::Pipeline;
use configuration::stages::declared;
use console::failure::Failure;
use console::mistake::{Mistake, SourceError};
use ports::Point;
use run::TopicRun;
use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};
use wire::{RefusalCause, StageId, TABLE};

use super::table::{At, Expect, FaultTable, File, Kill, Process, TopicTable};
use super::{Action, Consumer, Due, Faults, RunSpec, Spec, Target, What};
use crate::effect::{Effect, Random, TopicFault};
use crate::substitute::{crashing, dying};

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
        read(path, text, None).map_err(|mistake| mistake.at(&path.display().to_string(), text))
    }

    /// Returns the specification with another seed for the scene and all faults.
    pub fn seeded(&self, seed: u64) -> Result<Self, SourceError> {
        let Self { path, text, .. } = self;
        read(path, text, Some(seed)).map_err(|mistake| mistake.at(&path.display().to_string(), text))
    }
}

fn read(path: &Path, text: &str, seed: Option<u64>) -> Result<Spec, Mistake> {
    let syntax = |error| Mistake::syntax(text, &error);
    let mut table = DeTable::parse(text).map_err(syntax)?;
    let faults = table.get_mut().remove("fault");
    let mut file = File::deserialize(toml::Deserializer::from(table)).map_err(syntax)?;
    file.run.seed = seed.unwrap_or(file.run.seed);
    let faults = match faults.map(|faults| (faults.span(), faults.into_inner())) {
        None => Vec::new(),
        Some((_, DeValue::Array(faults))) => {
            faults.into_iter().map(FaultTable::read).collect::<Result<_, _>>()?
        }
        Some((span, _)) => return Err(Mistake::new(span, "`fault` is not a list", "expected [[fault]]")),
    };
    let mut spec = check(path, file, &faults)?;
    spec.text = text.to_owned();
    if let Some(seed) = seed {
        spec.faults.topics.iter_mut().for_each(|fault| fault.seed = seed);
    }
    Ok(spec)
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
    let from_folder = |path: PathBuf| if path.is_absolute() { path } else { folder.join(path) };
    let pipeline = file.run.pipeline.map(|path| {
        let span = path.span();
        (from_folder(path.into_inner()), span)
    });
    let (added, topics) =
        pipeline.as_ref().map_or(Ok(Default::default()), |(path, span)| added_to_pipeline(path, span))?;
    let mut run = RunSpec {
        stages: BTreeMap::new(),
        added,
        topics,
        ticks,
        agents: file.run.agents,
        recording: file.run.recording.map(from_folder),
        seed: file.run.seed,
        pipeline: pipeline.map(|(path, _)| path),
        forecasts: file.run.forecasts.map(from_folder),
        protect: file.run.protect,
        arguments: file.run.arguments,
    };
    for (name, keys) in file.run.stages {
        known_stage(name.get_ref(), name.span(), &run)?;
        run.stages.insert(name.into_inner(), keys);
    }
    let mut faults = Faults::default();
    for table in tables {
        faults.add(table, &run)?;
        faults.not_mixed(table.span())?;
    }
    expectations(&file.expect, &run)?;
    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let (path, text) = (path.to_owned(), String::new());
    Ok(Spec { name, path, text, shows: file.shows, run, faults, expect: file.expect })
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

impl Faults {
    fn act(&mut self, at: impl IntoIterator<Item = Due>, what: &What) {
        self.targets.extend(match *what {
            What::Kill(target) | What::Stop(target, _) => target.stage(),
            What::Limit(stage, ..) | What::Replace(stage, _) => Some(stage),
            What::Cpu(..) => None,
        });
        self.actions.extend(at.into_iter().map(|at| Action { at, what: what.clone() }));
    }

    /// Adds a fault.
    fn add(&mut self, table: &Spanned<FaultTable>, run: &RunSpec) -> Result<(), Mistake> {
        let at = |at| Ok::<_, Mistake>(ticks(at, run)?.into_iter().map(Due::Tick));
        let time = |ms: &u64| Duration::from_millis(*ms);
        let place = self.count as u64;
        self.count += 1;
        let process = match table.get_ref() {
            FaultTable::Topic(of, effect) => {
                self.topics.push(of_topic(of, *effect, run)?);
                return Ok(());
            }
            FaultTable::Process(process) => process,
        };
        match process {
            Process::Kill(kill) => self.kill(table.span(), kill, run)?,
            Process::Random { ticks, count, stages, for_ms } => {
                self.random(stages.as_ref(), range(ticks, run)?, count, for_ms.as_ref().map(time), run)?;
            }
            Process::Stop { stage, at: ticks, for_ms } => {
                let target = target(stage, run)?;
                self.act(at(ticks)?, &What::Stop(target, time(for_ms)));
                self.signalled.extend(target.stage());
            }
            Process::Limit { stage, at, resource, value } => {
                let what = What::Limit(self::stage(stage, run)?, *resource, *value);
                self.act([Due::Tick(tick(at, run)?)], &what);
            }
            Process::CrashLoop { stage, at, exit_code } => {
                let stage = self::stage(stage, run)?;
                self.act([Due::Tick(tick(at, run)?)], &What::Kill(Target::Stage(stage)));
                self.commands.push((stage, crashing(stage, exit_code.unwrap_or(3))));
            }
            Process::Command { stage, command } => {
                let stage = self::stage(stage, run)?;
                self.commands.push((stage, self::command(command)?));
                self.targets.push(stage);
            }
            Process::Replace { stage, at: ticks, command, point } => {
                let stage = self::stage(stage, run)?;
                let command = match (command, point) {
                    (Some(command), Some(_)) => {
                        let label = "without it the new process is the built-in one, which has points";
                        let message = "`command` and `point` exclude each other";
                        return Err(Mistake::new(command.span(), message, label));
                    }
                    (Some(command), None) => self::command(command)?,
                    (None, Some(point)) => dying(stage, known_point(stage, point)?),
                    (None, None) => Vec::new(),
                };
                self.act(at(ticks)?, &What::Replace(stage, command));
            }
            Process::Cpu { at, for_ms, threads } => {
                let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
                let threads = threads.unwrap_or(HOGS_PER_CORE * cores);
                self.act([Due::Tick(tick(at, run)?)], &What::Cpu(threads, time(for_ms)));
            }
            Process::Consumer { topic, hold_ms, within_ms } => self.consumers.push(Consumer {
                topic: self::topic(topic, run)?,
                hold_ms: *hold_ms,
                within_ms: within_ms.as_ref().map(within).transpose()?,
                random: Random::new(run.seed, place),
            }),
        }
        Ok(())
    }

    /// Each entry of a stage's points applies to one process in turn. A kill by signal in between would consume
    /// an entry.
    fn not_mixed(&self, newest: Range<usize>) -> Result<(), Mistake> {
        match self.points.iter().find(|(stage, ..)| self.signalled.contains(stage)) {
            None => Ok(()),
            Some((stage, ..)) => {
                let message = format!("the {} is killed at a point and by signals in one run", stage.name());
                Err(Mistake::new(newest, message, "make it a specification of its own"))
            }
        }
    }

    fn kill(&mut self, span: Range<usize>, kill: &Kill, run: &RunSpec) -> Result<(), Mistake> {
        let Kill { stage, at, after_start_ms, within_ms, point } = kill;
        let target = target(stage, run)?;
        let after = |ms| Due::AfterStart(target, Duration::from_millis(ms));
        match (within_ms, at, after_start_ms, point) {
            (Some(ms), None, None, None) => {
                let [shortest, longest] = within(ms)?;
                let ms = shortest + Random::new(run.seed, 0).below(longest - shortest + 1);
                self.act([after(ms)], &What::Kill(target));
            }
            (None, None, Some(ms), None) => self.act([after(*ms)], &What::Kill(target)),
            (None, Some(at), None, None) => {
                self.act(ticks(at, run)?.into_iter().map(Due::Tick), &What::Kill(target));
            }
            (None, Some(at), None, Some(point)) => {
                let stage = self::stage(stage, run)?;
                self.points.push((stage, known_point(stage, point)?, ticks(at, run)?));
                self.targets.push(stage);
                return Ok(());
            }
            _ => {
                let label = "needs `at`, alone or with a `point`, `after_start_ms` or `within_ms`";
                return Err(Mistake::new(span, "when does it kill?", label));
            }
        }
        self.signalled.extend(target.stage());
        Ok(())
    }

    /// Kills some of the stages at random ticks, or stops them for a time.
    fn random(
        &mut self,
        stages: Option<&Spanned<Vec<String>>>,
        [first, last]: [u64; 2],
        count: &Spanned<u64>,
        stop: Option<Duration>,
        run: &RunSpec,
    ) -> Result<(), Mistake> {
        let stages = random(stages, run)?;
        let faults = *count.get_ref();
        if faults > run.ticks {
            let message = format!("`count` = {faults} in a run of {} ticks", run.ticks);
            return Err(Mistake::new(count.span(), message, format!("expected at most {}", run.ticks)));
        }
        for place in 0..faults {
            let mut random = Random::new(run.seed, place);
            let target = Target::Stage(stages[random.below(stages.len() as u64) as usize]);
            let what = stop.map_or(What::Kill(target), |time| What::Stop(target, time));
            self.act([Due::Tick(first + random.below(last - first + 1))], &what);
        }
        self.targets.extend(stages);
        Ok(())
    }
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
