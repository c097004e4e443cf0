//! Converts the text of a specification to its meaning.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::config::{Mistake, Pipeline, SourceError};
use ports::Point;
use run::TopicRun;
use toml::Spanned;
use wire::{RefusalCause, StageId, TABLE};

use super::table::{At, Expect, FaultTable, File};
use super::{Fault, RunSpec, Spec, Target, TopicFault, When};
use crate::faults::effect::{Effect, Part};
use crate::stages::declared;

/// Kinds of process faults, with their required and optional keys.
const KINDS: [(&str, &[&str], &[&str]); 9] = [
    ("kill", &["stage"], &["at", "after_start_ms", "within_ms", "point"]),
    ("random", &["ticks", "count"], &["stages", "for_ms"]),
    ("stop", &["stage", "at", "for_ms"], &[]),
    ("limit", &["stage", "at", "resource", "value"], &[]),
    ("crash-loop", &["stage", "at"], &["exit_code"]),
    ("command", &["stage", "command"], &[]),
    ("replace", &["stage", "at"], &["command", "point"]),
    ("cpu", &["at", "for_ms"], &["threads"]),
    ("consumer", &["topic"], &["hold_ms", "within_ms"]),
];
/// Kinds of topic faults, with their required and optional keys in addition to the common ones.
const EFFECTS: [(&str, &[&str], &[&str]); 13] = [
    ("delay", &["delay_ms"], &["jitter_ms"]),
    ("drop", &[], &[]),
    ("duplicate", &[], &[]),
    ("reorder", &[], &[]),
    ("bit-flip", &[], &["bits", "in"]),
    ("not-finite", &[], &[]),
    ("huge", &[], &[]),
    ("wrong-length", &[], &[]),
    ("wrong-schema", &[], &[]),
    ("foreign-run", &[], &[]),
    ("old-incarnation", &[], &[]),
    ("frozen", &["in"], &[]),
    ("clock-jump", &["jump_ms"], &[]),
];
/// Required and optional keys of every topic fault.
const OF_TOPIC: (&[&str], &[&str]) = (&["topic", "ticks"], &["probability", "seed"]);
/// Causes for which a stage counts lost frames.
const COUNTERS: [&str; 3] = ["gap", "refused", "restart"];
/// Threads per core of a CPU fault, enough to leave a stage only a small share.
const HOGS_PER_CORE: usize = 8;

pub(super) fn parse(path: &Path, text: &str) -> Result<Spec, SourceError> {
    let name = path.display().to_string();
    let file: File = toml::from_str(text).map_err(|error| Mistake::syntax(text, &error).at(&name, text))?;
    check(path, file).map_err(|mistake| mistake.at(&name, text))
}

fn check(path: &Path, file: File) -> Result<Spec, Mistake> {
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
    let faults = file.faults.iter().map(|table| fault(table, &run)).collect::<Result<Vec<_>, _>>()?;
    for (i, table) in file.faults.iter().enumerate() {
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
    let (span, table) = (table.span(), table.get_ref());
    let kind = table.kind.get_ref().as_str();
    let of_kind = |list: &[(&'static str, &'static [&'static str], &'static [&'static str])]| {
        list.iter().find(|(name, ..)| *name == kind).map(|(_, must, may)| (*must, *may))
    };
    let (must, may) = match (of_kind(&KINDS), of_kind(&EFFECTS)) {
        (Some((must, may)), _) => (must.to_vec(), may.to_vec()),
        (None, Some((must, may))) => ([OF_TOPIC.0, must].concat(), [OF_TOPIC.1, may].concat()),
        (None, None) => {
            let known: Vec<&str> = KINDS.iter().chain(&EFFECTS).map(|(name, ..)| *name).collect();
            let label = format!("expected one of {}", known.join(", "));
            return Err(Mistake::new(table.kind.span(), format!("unknown kind of fault \"{kind}\""), label));
        }
    };
    let keys = table.keys();
    if let Some((key, span)) = keys.iter().find(|(key, _)| !must.contains(key) && !may.contains(key)) {
        let expected = [&must[..], &may[..]].concat().join(", ");
        let label = format!("a \"{kind}\" has {expected}");
        return Err(Mistake::new(
            span.clone(),
            format!("`{key}` means nothing to a fault \"{kind}\""),
            label,
        ));
    }
    if let Some(missing) = must.iter().find(|key| !keys.iter().any(|(set, _)| set == *key)) {
        return Err(Mistake::new(span, format!("a fault \"{kind}\" needs `{missing}`"), "in this fault"));
    }
    match kind {
        "kill" => kill(table, span, run),
        "random" => random(table, run),
        "stop" => Ok(Fault::Stop {
            target: target(table, run)?,
            ticks: ticks(table, run)?,
            for_ms: value(&table.for_ms),
        }),
        "limit" => {
            let resource = *table.resource.as_ref().expect("a key that the kind must have").get_ref();
            let (stage, tick) = (stage(table, run)?, tick(table, run)?);
            Ok(Fault::Limit { stage, tick, resource, value: value(&table.value) })
        }
        "crash-loop" => {
            let exit_code = table.exit_code.as_ref().map_or(3, |code| *code.get_ref());
            Ok(Fault::CrashLoop { stage: stage(table, run)?, tick: tick(table, run)?, exit_code })
        }
        "command" => {
            let command = command(table)?.expect("a key that the kind must have");
            Ok(Fault::Command { stage: stage(table, run)?, command })
        }
        "replace" => {
            let (stage, ticks, command) = (stage(table, run)?, ticks(table, run)?, command(table)?);
            let point = table.point.as_ref().map(|point| known_point(stage, point)).transpose()?;
            if let Some(command) = table.command.as_ref().filter(|_| point.is_some()) {
                let label = "without it the new process is the built-in one, which has points";
                return Err(Mistake::new(command.span(), "`command` and `point` exclude each other", label));
            }
            Ok(Fault::Replace { stage, ticks, command, point })
        }
        "cpu" => {
            let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
            let threads = table.threads.as_ref().map_or(HOGS_PER_CORE * cores, |threads| *threads.get_ref());
            Ok(Fault::Cpu { tick: tick(table, run)?, for_ms: value(&table.for_ms), threads })
        }
        "consumer" => {
            let hold_ms = table.hold_ms.as_ref().map(|ms| *ms.get_ref());
            let within_ms = table.within_ms.as_ref().map(within).transpose()?;
            Ok(Fault::Consumer { topic: topic(table, run)?, hold_ms, within_ms })
        }
        _ => of_topic(kind, table, run).map(Fault::Topic),
    }
}

fn kill(table: &FaultTable, span: Range<usize>, run: &RunSpec) -> Result<Fault, Mistake> {
    let is_alone = table.point.is_none() && table.at.is_none() && table.after_start_ms.is_none();
    if let Some(within) = &table.within_ms {
        if !is_alone {
            return Err(Mistake::new(span, "when does it kill?", "`within_ms` needs no other time"));
        }
        let ms = self::within(within)?;
        return Ok(Fault::Kill { target: target(table, run)?, when: When::Within { ms } });
    }
    match (&table.point, &table.at, &table.after_start_ms) {
        (Some(point), Some(_), None) => {
            let stage = stage(table, run)?;
            Ok(Fault::KillAt { stage, point: known_point(stage, point)?, ticks: ticks(table, run)? })
        }
        (None, Some(_), None) => {
            Ok(Fault::Kill { target: target(table, run)?, when: When::Ticks(ticks(table, run)?) })
        }
        (None, None, Some(ms)) => {
            Ok(Fault::Kill { target: target(table, run)?, when: When::AfterStart { ms: *ms.get_ref() } })
        }
        _ => Err(Mistake::new(
            span,
            "when does it kill?",
            "needs `at`, alone or with a `point`, `after_start_ms` or `within_ms`",
        )),
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

/// Kills or stops at random ticks; applies to all stages if none are named.
fn random(table: &FaultTable, run: &RunSpec) -> Result<Fault, Mistake> {
    let stages: Vec<StageId> = match &table.stages {
        None => run.stages().map(|(stage, _)| stage).collect(),
        Some(names) => {
            let of = |name: &String| known_stage(name, names.span(), run);
            names.get_ref().iter().map(of).collect::<Result<_, _>>()?
        }
    };
    if stages.is_empty() {
        let span = table.stages.as_ref().map_or(0..0, Spanned::span);
        return Err(Mistake::new(span, "`stages` is empty", "expected names of stages"));
    }
    let ticks = range(table, run)?;
    let stop_ms = table.for_ms.as_ref().map(|ms| *ms.get_ref());
    Ok(Fault::Random { stages, ticks, count: value(&table.count), stop_ms })
}

/// The range of ticks in which a fault may act.
fn range(table: &FaultTable, run: &RunSpec) -> Result<[u64; 2], Mistake> {
    let ticks = table.ticks.as_ref().expect("a key that the kind must have");
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

/// Returns the command, if any.
fn command(table: &FaultTable) -> Result<Option<Vec<String>>, Mistake> {
    match &table.command {
        Some(command) if command.get_ref().is_empty() => {
            Err(Mistake::new(command.span(), "`command` is empty", "expected [\"program\", …]"))
        }
        command => Ok(command.as_ref().map(|command| command.get_ref().clone())),
    }
}

fn of_topic(kind: &str, table: &FaultTable, run: &RunSpec) -> Result<TopicFault, Mistake> {
    let effect = match kind {
        "delay" => Effect::Delay {
            ms: value(&table.delay_ms),
            jitter_ms: table.jitter_ms.as_ref().map_or(0, |ms| *ms.get_ref()),
        },
        "drop" => Effect::Drop,
        "duplicate" => Effect::Duplicate,
        "reorder" => Effect::Reorder,
        "bit-flip" => {
            let bits = table.bits.as_ref().map_or(1, |bits| *bits.get_ref());
            Effect::BitFlip { bits, part: part(table, &["header", "payload"])?.unwrap_or(Part::Payload) }
        }
        "not-finite" => Effect::NotFinite,
        "huge" => Effect::Huge,
        "wrong-length" => Effect::WrongLength,
        "wrong-schema" => Effect::WrongSchema,
        "foreign-run" => Effect::ForeignRun,
        "old-incarnation" => Effect::OldIncarnation,
        "frozen" => Effect::Frozen { part: part(table, &["stamp", "payload"])?.unwrap_or(Part::Stamp) },
        _ => Effect::ClockJump { ms: table.jump_ms.as_ref().map_or(0, |ms| *ms.get_ref()) },
    };
    let [first, last] = range(table, run)?;
    let probability = table.probability.as_ref().map_or(1.0, |probability| *probability.get_ref());
    if !(probability > 0.0 && probability <= 1.0) {
        let span = table.probability.as_ref().map_or(0..0, Spanned::span);
        return Err(Mistake::new(
            span,
            format!("`probability` = {probability}"),
            "expected more than 0, at most 1",
        ));
    }
    let seed = table.seed.as_ref().map_or(run.seed, |seed| *seed.get_ref());
    let topic = topic(table, run)?;
    let has_fields = |topic: &TopicRun| TABLE.topics.iter().any(|known| known.type_name == topic.type_name);
    let unknown = run.topics.iter().find(|declared| declared.name == topic && !has_fields(declared));
    if let (Some(unknown), Effect::NotFinite | Effect::Huge) = (unknown, effect) {
        let message =
            format!("\"{kind}\" on \"{topic}\": the fields of \"{}\" are not known", unknown.type_name);
        let label = "expected a topic whose numbers are known; a \"bit-flip\" needs no fields";
        return Err(Mistake::new(table.topic.as_ref().map_or(0..0, Spanned::span), message, label));
    }
    Ok(TopicFault { topic, effect, ticks: [first, last], probability, seed })
}

fn part(table: &FaultTable, known: &[&str]) -> Result<Option<Part>, Mistake> {
    let Some(part) = &table.r#in else { return Ok(None) };
    let found = match part.get_ref().as_str() {
        "header" => Some(Part::Header),
        "payload" => Some(Part::Payload),
        "stamp" => Some(Part::Stamp),
        _ => None,
    };
    match found.filter(|_| known.contains(&part.get_ref().as_str())) {
        Some(found) => Ok(Some(found)),
        None => {
            let label = format!("expected {}", known.join(" or "));
            Err(Mistake::new(part.span(), format!("`in` = \"{}\"", part.get_ref()), label))
        }
    }
}

fn value(of: &Option<Spanned<u64>>) -> u64 {
    of.as_ref().map_or(0, |value| *value.get_ref())
}

fn ticks(table: &FaultTable, run: &RunSpec) -> Result<Vec<u64>, Mistake> {
    let at = table.at.as_ref().expect("a key that the kind must have");
    let ticks = match at.get_ref() {
        At::One(tick) => vec![*tick],
        At::Many(ticks) => ticks.clone(),
    };
    if ticks.is_empty() || !ticks.is_sorted_by(|a, b| a < b) {
        return Err(Mistake::new(
            at.span(),
            format!("`at` = {ticks:?}"),
            "expected ticks, each after the one before",
        ));
    }
    match ticks.last() {
        Some(last) if *last >= run.ticks => {
            let message = format!("`at` = {last} of a run of {} ticks", run.ticks);
            Err(Mistake::new(at.span(), message, format!("expected less than {}", run.ticks)))
        }
        _ => Ok(ticks),
    }
}

fn tick(table: &FaultTable, run: &RunSpec) -> Result<u64, Mistake> {
    match &ticks(table, run)?[..] {
        [tick] => Ok(*tick),
        more => {
            let span = table.at.as_ref().map_or(0..0, Spanned::span);
            Err(Mistake::new(
                span,
                format!("`at` = {more:?}"),
                "expected a single tick for this kind of fault",
            ))
        }
    }
}

fn target(table: &FaultTable, run: &RunSpec) -> Result<Target, Mistake> {
    match &table.stage {
        Some(name) if name.get_ref() == "launcher" => Ok(Target::Launcher),
        _ => stage(table, run).map(Target::Stage),
    }
}

fn stage(table: &FaultTable, run: &RunSpec) -> Result<StageId, Mistake> {
    let name = table.stage.as_ref().expect("a key that the kind must have");
    known_stage(name.get_ref(), name.span(), run)
}

fn known_stage(name: &str, span: Range<usize>, run: &RunSpec) -> Result<StageId, Mistake> {
    run.stage(name).ok_or_else(|| {
        let known: Vec<&str> = run.stages().map(|(_, name)| name).collect();
        let label = format!("expected one of {}", known.join(", "));
        Mistake::new(span, format!("unknown stage \"{name}\""), label)
    })
}

fn topic(table: &FaultTable, run: &RunSpec) -> Result<String, Mistake> {
    let name = table.topic.as_ref().expect("a key that the kind must have");
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
        let kinds = || EFFECTS.iter().map(|(name, ..)| *name);
        if let Some(kind) =
            counted.as_injected.as_ref().filter(|kind| !kinds().any(|known| known == kind.as_str()))
        {
            let label =
                format!("in `[[expect.counted]]`; the kinds are {}", kinds().collect::<Vec<_>>().join(", "));
            return Err(Mistake::new(0..0, format!("unknown kind of fault \"{kind}\""), label));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(body: &str) -> Result<Spec, String> {
        let text = format!("shows = \"a test\"\n[run]\nticks = 100\n{body}");
        parse(Path::new("folder/07-test.toml"), &text).map_err(|error| error.to_string())
    }

    fn refused(body: &str, with: &str) {
        let error = spec(body).expect_err(body);
        assert!(error.starts_with("folder/07-test.toml:") && error.contains(with), "{body}: {error}");
    }

    #[test]
    fn a_specification_is_read() {
        let read = spec(
            "recording = \"a.csv\"\nseed = 4\n[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\nticks = [20, 40]\n\
             probability = 0.5\n[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = [30, 60]\npoint = \"mid-write\"\n\
             [expect]\nhole_max = 3\ncounted = [{ stage = \"localiser\", cause = \"gap\", as_injected = \"drop\" }]",
        )
        .unwrap();
        assert_eq!((read.name.as_str(), read.run.recording), ("07-test", Some("folder/a.csv".into())));
        let topic = TopicFault {
            topic: "tracks".into(),
            effect: Effect::Drop,
            ticks: [20, 40],
            probability: 0.5,
            seed: 4,
        };
        assert!(matches!(&read.faults[0], Fault::Topic(fault) if *fault == topic), "{:?}", read.faults);
        let Fault::KillAt { stage: StageId::Decoder, point: Point::MidWrite, ticks } = &read.faults[1] else {
            panic!("{:?}", read.faults)
        };
        assert_eq!((ticks, read.expect.hole_max), (&vec![30, 60], Some(3)));
    }

    #[test]
    fn stages_that_the_pipeline_adds_are_known() {
        let folder = tempfile::tempdir().unwrap();
        let added = "\n[[stage]]\nname = \"monitor\"\ncommand = [\"sleep\", \"9\"]\nreads = [\"tracks\"]\n";
        std::fs::write(folder.path().join("p.toml"), format!("{}{added}", crate::pipeline_file::SHIPPED))
            .unwrap();
        let read = |pipeline: &str, body: &str| {
            let text = format!("shows = \"a test\"\n[run]\nticks = 100\npipeline = \"{pipeline}\"\n{body}");
            parse(&folder.path().join("a.toml"), &text).map_err(|error| error.to_string())
        };
        let spec = read(
            "p.toml",
            "stages = { monitor = { restarts_max = 2 } }\n[[fault]]\nkind = \"kill\"\nstage = \"monitor\"\nat = 9\n\
             [[fault]]\nkind = \"kill\"\nstage = \"monitor\"\npoint = \"idle\"\nat = 9",
        );
        assert!(spec.unwrap_err().contains(":10: the monitor is killed at a point and by signals"));
        let spec = read(
            "p.toml",
            "[[fault]]\nkind = \"stop\"\nstage = \"monitor\"\nat = 9\nfor_ms = 5\n[expect]\n\
             outages = [{ stage = \"monitor\", count = 1 }]",
        );
        assert_eq!(spec.unwrap().targets(), [StageId::added(0).unwrap()]);
        let kill = "[[fault]]\nkind = \"kill\"\nat = 9\nstage = ";
        let error = read("p.toml", &format!("{kill}\"monitors\"")).unwrap_err();
        assert!(error.contains("a.toml:8: unknown stage \"monitors\""), "{error}");
        refused(&format!("{kill}\"monitor\""), ":7: unknown stage \"monitor\"");
        let error = read("q.toml", "").unwrap_err();
        assert!(error.contains("a.toml:4: `pipeline`: ") && error.contains("q.toml"), "{error}");
    }

    #[test]
    fn topics_that_the_pipeline_declares_are_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/examples/pipeline.toml");
        let head = format!("shows = \"a test\"\n[run]\nticks = 100\npipeline = \"{examples}\"\n");
        let read = |fault: &str| {
            let text = format!("{head}[[fault]]\n{fault}\nticks = [1, 2]\n");
            parse(&path, &text).map_err(|error| error.to_string())
        };
        let injected = |fault: &str| read(fault).unwrap().injected_topics().join(", ");
        assert_eq!(injected("kind = \"bit-flip\"\ntopic = \"approaches\""), "approaches");
        // The element type is a track, whose fields are known.
        assert_eq!(injected("kind = \"not-finite\"\ntopic = \"limited-tracks\""), "limited-tracks");
        for kind in ["not-finite", "huge"] {
            let error = read(&format!("kind = \"{kind}\"\ntopic = \"approaches\"")).unwrap_err();
            let told =
                format!("a.toml:7: \"{kind}\" on \"approaches\": the fields of \"approach.1\" are not known");
            assert!(error.contains(&told), "{error}");
        }
        let error = read("kind = \"drop\"\ntopic = \"approach\"").unwrap_err();
        assert!(error.contains("a.toml:7: unknown topic \"approach\""), "{error}");
        refused(
            "[[fault]]\nkind = \"drop\"\ntopic = \"approaches\"\nticks = [1, 2]",
            ":6: unknown topic \"approaches\"",
        );
    }

    #[test]
    fn mistakes_name_the_line_the_value_and_what_is_expected() {
        refused("[[fault]]\nkind = \"explode\"", ":5: unknown kind of fault \"explode\"");
        refused(
            "[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = 100",
            ":7: `at` = 100 of a run of 100 ticks",
        );
        refused("[[fault]]\nkind = \"kill\"\nstage = \"enkoder\"\nat = 10", ":6: unknown stage \"enkoder\"");
        refused("[[fault]]\nkind = \"kill\"\nstage = \"decoder\"", ":4: when does it kill?");
        refused(
            "[[fault]]\nkind = \"stop\"\nstage = \"decoder\"\nat = 10",
            ":4: a fault \"stop\" needs `for_ms`",
        );
        refused(
            "[[fault]]\nkind = \"cpu\"\nat = 10\nfor_ms = 5\nbits = 2",
            ":8: `bits` means nothing to a fault \"cpu\"",
        );
        refused(
            "[[fault]]\nkind = \"kill\"\nstage = \"recorder\"\npoint = \"mid-write\"\nat = 9",
            ":7: the recorder has no point \"mid-write\"",
        );
        refused(
            "[[fault]]\nkind = \"drop\"\ntopic = \"trucks\"\nticks = [1, 2]",
            ":6: unknown topic \"trucks\"",
        );
        refused("[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\nticks = [3, 2]", ":7: `ticks` = [3, 2]");
        refused(
            "[[fault]]\nkind = \"replace\"\nstage = \"encoder\"\nat = 9\npoint = \"idle\"\ncommand = [\"a\"]",
            ":9: `command` and `point` exclude each other",
        );
        refused("[expect]\nhole = 3", ":5: unknown field `hole`");
        refused("[expect]\ngiven_up = [\"me\"]", "unknown stage \"me\"");
        refused(
            "[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\nat = 9\n[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\n\
             point = \"idle\"\nat = 20",
            ":8: the decoder is killed at a point and by signals",
        );
    }
}
