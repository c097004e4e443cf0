use std::collections::BTreeMap;
use std::time::Duration;

use console::mistake::Mistake;
use run::{Declared, PROTECTED, TopicRun};
use supervisor::{Restart, RestartPolicy};
use toml::Spanned;
use wire::{HOPS_MAX, StageId, TICK_MS, UnknownWorldOrigin};

use super::added::{self, name_of};
use super::file::{File, StageTable};
use super::options::options;
use super::realtime;
use super::{Pipeline, Stage};

/// Largest sum of all budgets: one tick.
pub const BUDGET_MAX_MS: f64 = TICK_MS;

/// Largest number of reader places that the file can add to a topic. A writer reserves memory for each.
const READERS_MAX: u32 = 64;

/// Checks stage by stage, then the graph as a whole.
pub(super) fn check(file: &File, declared: &[&dyn Declared]) -> Result<Pipeline, Mistake> {
    let mut warnings = Vec::new();
    let topics = added::topics(file)?;
    let tables: Vec<&StageTable> = file.stages.iter().map(Spanned::get_ref).collect();
    let mut stages = Vec::with_capacity(tables.len());
    for table in &tables {
        let added_count = stages.iter().filter(|stage: &&Stage| stage.id.is_added()).count();
        stages.push(stage(table, added_count, &topics, declared)?);
    }
    unique_names(&tables)?;
    producers(file, &topics)?;
    added::written(file, &topics)?;
    acyclic(&tables, &topics)?;
    warnings.extend(tables.iter().flat_map(|table| unwritten(table, &tables)));
    let way = way(&tables, &topics);
    let budget_ms = budgets(&tables, &way)?;
    if way.len() > HOPS_MAX {
        warnings.push(format!(
            "a tick passes {} stages, and the times of {HOPS_MAX} have room: the report tells how many are missing",
            way.len()
        ));
    }
    for needed in [StageId::Source, StageId::Sampler, StageId::Recorder] {
        if !stages.iter().any(|s| s.id == needed) {
            let message = format!("there is no stage \"{}\"", needed.name());
            return Err(Mistake::new(0..0, message, "needed in every pipeline"));
        }
    }
    let protected = match &file.protect {
        None => PROTECTED.map(str::to_owned).to_vec(),
        Some(listed) => {
            listed.iter().try_for_each(|topic| known(topic, &[], declared))?;
            names(listed)
        }
    };
    let shed = file.shed.unwrap_or(true);
    if shed {
        warnings.extend(late_controls(&tables));
    }
    let parse = |origin: &Spanned<String>| {
        let refused = |error: UnknownWorldOrigin| Mistake::new(origin.span(), error.to_string(), "no origin");
        origin.get_ref().parse().map_err(refused)
    };
    let origin = file.origin.as_ref().map(parse).transpose()?;
    let weights = file.weights.clone();
    let realtime = realtime::apply(file, &ranks(&tables, &way, &topics), &mut stages)?;
    let readers = readers(file, &topics, declared)?;
    Ok(Pipeline { weights, origin, protected, shed, realtime, readers, stages, topics, budget_ms, warnings })
}

/// The reader places that the file adds.
fn readers(
    file: &File,
    topics: &[TopicRun],
    declared: &[&dyn Declared],
) -> Result<BTreeMap<String, u32>, Mistake> {
    let number = |(topic, places): (&Spanned<String>, &Spanned<u64>)| {
        known(topic, topics, declared)?;
        let found = u32::try_from(*places.get_ref()).ok().filter(|found| (1..=READERS_MAX).contains(found));
        let found = found.ok_or_else(|| {
            let message = format!("{} further readers of \"{}\"", places.get_ref(), topic.get_ref());
            Mistake::new(places.span(), message, format!("expected 1 to {READERS_MAX}"))
        })?;
        Ok((topic.get_ref().clone(), found))
    };
    file.readers.iter().map(number).collect()
}

fn stage(
    table: &StageTable,
    added_count: usize,
    topics: &[TopicRun],
    declared: &[&dyn Declared],
) -> Result<Stage, Mistake> {
    let id = added::stage_id(table, added_count)?;
    table.reads.iter().chain(&table.writes).try_for_each(|topic| known(topic, topics, declared))?;
    if let Some(command) = table.command.as_ref().filter(|c| c.get_ref().is_empty()) {
        return Err(Mistake::new(
            command.span(),
            "`command` is empty",
            "expected [\"program\", \"argument\", …]",
        ));
    }
    let options = match (&table.command, declared.iter().find(|declared| declared.id() == id)) {
        // Only the program of the `command` can check its options.
        (Some(_), _) => {
            table.options.iter().map(|(k, v)| (k.get_ref().clone(), v.get_ref().clone())).collect()
        }
        (None, Some(built_in)) => {
            topics_of(*built_in, table)?;
            options(*built_in, &table.options, declared)?
        }
        (None, None) => {
            let message = format!("there is no program for the {}", id.name());
            return Err(Mistake::new(table.name.span(), message, "needs a `command`"));
        }
    };
    Ok(Stage {
        id,
        name: table.name.get_ref().clone(),
        command: table.command.as_ref().map(|c| c.get_ref().clone()),
        reads: names(&table.reads),
        writes: names(&table.writes),
        budget_ms: table.budget_ms.as_ref().map(|ms| *ms.get_ref()),
        options,
        places: BTreeMap::new(),
        topics: renamed(table, topics, declared)?,
        restart: restart(table)?,
        scheduling: realtime::of_stage(table)?,
        spare: spare(table)?,
    })
}

/// The topics that the stage opens under another name. Shipped topics' names are refused.
fn renamed(
    table: &StageTable,
    topics: &[TopicRun],
    declared: &[&dyn Declared],
) -> Result<BTreeMap<String, String>, Mistake> {
    for (topic, name) in &table.topics {
        if !table.reads.iter().chain(&table.writes).any(|own| own.get_ref() == topic.get_ref()) {
            let message =
                format!("the {} neither reads nor writes \"{}\"", table.name.get_ref(), topic.get_ref());
            return Err(Mistake::new(topic.span(), message, "not one of its `reads` and `writes`"));
        }
        let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        let (text, span) = (name.get_ref(), name.span());
        if text.is_empty() || !text.chars().all(is_plain) {
            let message = format!("\"{text}\" can't be the name of a topic");
            return Err(Mistake::new(span, message, "expected lower case letters, digits, \"-\" and \"_\""));
        }
        if known(name, &[], declared).is_ok() {
            let message = format!("\"{text}\" is a topic of its own");
            return Err(Mistake::new(span, message, "expected another name"));
        }
        same_type(table, topic, name, topics)?;
    }
    Ok(table.topics.iter().map(|(topic, name)| (topic.get_ref().clone(), name.get_ref().clone())).collect())
}

/// Refuses a declared topic that replaces a topic of another type.
fn same_type(
    table: &StageTable,
    topic: &Spanned<String>,
    name: &Spanned<String>,
    topics: &[TopicRun],
) -> Result<(), Mistake> {
    let declared = added::declared_name(name.get_ref(), topics);
    let Some(other) = topics.iter().find(|other| declared == Some(&other.name)) else { return Ok(()) };
    let own = topics.iter().find(|own| own.name == *topic.get_ref());
    let expected =
        own.map(|own| own.type_name.as_str()).or_else(|| Some(added::shipped(topic.get_ref())?.type_name));
    if expected.is_some_and(|expected| expected != other.type_name) {
        let message = format!("\"{}\" has the type \"{}\"", other.name, other.type_name);
        let expected = expected.unwrap_or_default();
        return Err(Mistake::new(name.span(), message, format!("\"{}\" is \"{expected}\"", topic.get_ref())));
    }
    if is_feedback(table, topic.get_ref()) {
        let message = "the forecasts that go back to the tracker have no other name";
        return Err(Mistake::new(name.span(), message, "the tracker reads those of the sampler"));
    }
    Ok(())
}

/// Refuses a topic that no stage reads or writes and that the file does not declare.
fn known(topic: &Spanned<String>, added: &[TopicRun], declared: &[&dyn Declared]) -> Result<(), Mistake> {
    let mut topics: Vec<&str> = Vec::new();
    for topic in declared.iter().flat_map(|stage| stage.writes().iter().chain(stage.reads())) {
        if !topics.contains(topic) {
            topics.push(topic);
        }
    }
    topics.extend(added.iter().map(|topic| topic.name.as_str()));
    if topics.contains(&topic.get_ref().as_str()) {
        return Ok(());
    }
    let message = format!("unknown topic \"{}\"", topic.get_ref());
    Err(Mistake::new(topic.span(), message, "no topic has this name")
        .help(format!("the topics are {}; one of your own is declared by [[topic]]", topics.join(", "))))
}

/// The stage's restart policy. Missing values have their defaults.
fn restart(table: &StageTable) -> Result<RestartPolicy, Mistake> {
    let defaults = RestartPolicy::default();
    let number = |value: &Option<Spanned<u64>>, default: u64, [least, most]: [u64; 2]| match value {
        None => Ok(default),
        Some(value) if (least..=most).contains(value.get_ref()) => Ok(*value.get_ref()),
        Some(value) => {
            let advice = format!("expected {least} to {most}");
            Err(Mistake::new(value.span(), "a number of the restart policy is out of range", advice))
        }
    };
    let ms = |of: Duration| of.as_millis() as u64;
    let backoff_max_ms = ms(RestartPolicy::BACKOFF_MAX);
    let backoff_ms = number(&table.backoff_ms, ms(defaults.backoff), [0, backoff_max_ms])?;
    let restarts_max = number(&table.restarts_max, u64::from(defaults.restarts_max), [1, 1_000_000])?;
    let window_s = number(&table.window_s, defaults.window.as_secs(), [1, 86_400])?;
    let start_limit_s = number(&table.start_limit_s, defaults.start_limit.as_secs(), [1, 600])?;
    let hang_after_ms = number(&table.hang_after_ms, ms(defaults.hang_after), [200, 600_000])?;
    Ok(RestartPolicy {
        restart: table.restart.unwrap_or_default(),
        backoff: Duration::from_millis(backoff_ms),
        restarts_max: restarts_max as u32,
        window: Duration::from_secs(window_s),
        start_limit: Duration::from_secs(start_limit_s),
        hang_after: Duration::from_millis(hang_after_ms),
    })
}

/// Whether the stage has a spare. A spare takes its place only if the stage is started again at all.
fn spare(table: &StageTable) -> Result<bool, Mistake> {
    match &table.spare {
        Some(spare) if *spare.get_ref() && table.restart == Some(Restart::Never) => {
            let message = format!("the spare of the {} would never take its place", table.name.get_ref());
            Err(Mistake::new(spare.span(), message, "not with restart = \"never\""))
        }
        spare => Ok(spare.as_ref().is_some_and(|spare| *spare.get_ref())),
    }
}

/// Refuses programs and processors that this machine does not have.
pub(super) fn check_here(
    file: &File,
    find: &dyn Fn(&str) -> Result<(), String>,
    has_cpu: &dyn Fn(u32) -> bool,
) -> Result<(), Mistake> {
    for table in file.stages.iter().map(Spanned::get_ref) {
        let name = table.name.get_ref();
        if let Some(command) = &table.command
            && let Some(program) = command.get_ref().first()
            && let Err(why) = find(program)
        {
            let message = format!("the {name} can't be started: {program}: {why}");
            return Err(Mistake::new(command.span(), message, "expected a program of this machine"));
        }
        let missing = |cpu: &&Spanned<u64>| !u32::try_from(*cpu.get_ref()).is_ok_and(has_cpu);
        if let Some(cpu) = table.cpu.iter().flat_map(Spanned::get_ref).find(missing) {
            let message = format!("the {name} can't have processor {}", cpu.get_ref());
            return Err(Mistake::new(cpu.span(), message, realtime::MISSING));
        }
    }
    realtime::check_here(file, has_cpu)
}

fn names(topics: &[Spanned<String>]) -> Vec<String> {
    topics.iter().map(|t| t.get_ref().clone()).collect()
}

/// Refuses other topics than the fixed ones of this project's own program.
fn topics_of(stage: &dyn Declared, table: &StageTable) -> Result<(), Mistake> {
    let id = stage.id();
    for (key, written, real) in
        [("reads", &table.reads, stage.reads()), ("writes", &table.writes, stage.writes())]
    {
        let wrong = written.iter().find(|t| !real.contains(&t.get_ref().as_str()));
        let missing = real.iter().find(|r| !written.iter().any(|t| t.get_ref() == *r));
        let (span, label) = match (wrong, missing) {
            (Some(topic), _) => (topic.span(), format!("the {} does not {} it", id.name(), verb(key))),
            (None, Some(topic)) => (table.name.span(), format!("its program also {key} \"{topic}\"")),
            (None, None) => continue,
        };
        let message = format!("`{key}` is not what the {} {key}", id.name());
        return Err(Mistake::new(span, message, label).help(format!("{key} = {real:?}, or give a `command`")));
    }
    Ok(())
}

fn verb(key: &str) -> &str {
    key.trim_end_matches('s')
}

fn unique_names(tables: &[&StageTable]) -> Result<(), Mistake> {
    for (i, table) in tables.iter().enumerate() {
        if tables[..i].iter().any(|earlier| earlier.name == table.name) {
            let message = format!("the stage \"{}\" is defined twice", table.name.get_ref());
            return Err(Mistake::new(table.name.span(), message, "defined before"));
        }
    }
    Ok(())
}

fn producers(file: &File, topics: &[TopicRun]) -> Result<(), Mistake> {
    let mut producer: BTreeMap<&str, &str> = BTreeMap::new();
    let tables = || file.stages.iter().map(Spanned::get_ref);
    for table in tables() {
        for topic in &table.writes {
            let name = name_of(table, topic.get_ref(), topics);
            if let Some(other) = producer.insert(name, table.name.get_ref()) {
                let message = format!("\"{name}\" is written by two stages");
                return Err(Mistake::new(topic.span(), message, format!("the {other} writes it already")));
            }
        }
    }
    for table in tables() {
        for topic in &table.reads {
            let name = name_of(table, topic.get_ref(), topics);
            if !producer.contains_key(name) {
                let message = format!("no stage writes \"{name}\"");
                return Err(Mistake::new(topic.span(), message, "read here"));
            }
        }
    }
    Ok(())
}

/// Repeatedly removes the stages whose inputs all come from removed stages. The remaining stages form a
/// cycle.
fn acyclic(tables: &[&StageTable], topics: &[TopicRun]) -> Result<(), Mistake> {
    let mut open = tables.to_vec();
    while let Some(ready) = open.iter().position(|table| open_input(table, &open, topics).is_none()) {
        open.remove(ready);
    }
    let Some((stage, topic)) =
        open.first().and_then(|stage| Some((stage, open_input(stage, &open, topics)?)))
    else {
        return Ok(());
    };
    let message = format!("a cycle: the {} needs its own output", stage.name.get_ref());
    let label = format!("\"{}\" is made from what this stage writes", topic.get_ref());
    Err(Mistake::new(topic.span(), message, label)
        .help("the only cycle allowed is that of the tracker, which reads \"forecasts\""))
}

/// Whether a stage reads the frames of earlier ticks from a topic, by its own name.
fn is_feedback(table: &StageTable, topic: &str) -> bool {
    StageId::from_name(table.name.get_ref()).is_some_and(|stage| run::is_feedback(stage, topic))
}

/// The first input of a stage that one of the open stages writes in the same tick.
fn open_input<'a>(
    table: &'a StageTable,
    open: &[&StageTable],
    topics: &[TopicRun],
) -> Option<&'a Spanned<String>> {
    table.reads.iter().find(|read| {
        let topic = read.get_ref();
        !is_feedback(table, topic)
            && open.iter().any(|other| writes(other, name_of(table, topic, topics), topics))
    })
}

fn writes(table: &StageTable, name: &str, topics: &[TopicRun]) -> bool {
    table.writes.iter().any(|written| name_of(table, written.get_ref(), topics) == name)
}

/// Names of the stages on a tick's way: the sampler, and the stages whose output reaches it.
fn way<'a>(tables: &[&'a StageTable], topics: &[TopicRun]) -> Vec<&'a str> {
    let named = |name: &str| tables.iter().copied().find(|table| table.name.get_ref() == name);
    let (mut way, mut open) = (Vec::new(), Vec::from_iter(named(StageId::Sampler.name())));
    while let Some(table) = open.pop() {
        if way.contains(&table.name.get_ref().as_str()) {
            continue;
        }
        way.push(table.name.get_ref().as_str());
        open.extend(producers_of(table, tables, topics));
    }
    way
}

/// The stages that write an input of a stage in the same tick.
fn producers_of<'a>(
    table: &StageTable,
    tables: &[&'a StageTable],
    topics: &[TopicRun],
) -> Vec<&'a StageTable> {
    let reads = table.reads.iter().map(Spanned::get_ref).filter(|read| !is_feedback(table, read));
    let names: Vec<&str> = reads.map(|read| name_of(table, read, topics)).collect();
    let is_producer = |other: &&StageTable| names.iter().any(|name| writes(other, name, topics));
    tables.iter().copied().filter(is_producer).collect()
}

/// For each stage on a tick's way, the largest number of stages before it; `None` for the others.
fn ranks(tables: &[&StageTable], way: &[&str], topics: &[TopicRun]) -> Vec<Option<u8>> {
    let place = |of: &StageTable| tables.iter().position(|table| table.name.get_ref() == of.name.get_ref());
    let mut ranks = vec![0_u8; tables.len()];
    // The graph has no cycle, so every stage has its rank after as many rounds as there are stages.
    for _ in tables {
        for (i, table) in tables.iter().enumerate() {
            let before =
                producers_of(table, tables, topics).into_iter().filter_map(place).map(|j| ranks[j]).max();
            ranks[i] = before.map_or(0, |rank| rank.saturating_add(1));
        }
    }
    let is_on_way = |table: &StageTable| way.contains(&table.name.get_ref().as_str());
    tables.iter().zip(ranks).map(|(table, rank)| is_on_way(table).then_some(rank)).collect()
}

/// Warnings that a stage reads a topic that no stage of the file writes under this name. Its writer may be a
/// program that the launcher does not start.
fn unwritten(table: &StageTable, tables: &[&StageTable]) -> Vec<String> {
    fn opened<'a>(table: &'a StageTable, topic: &'a str) -> &'a str {
        let renamed = table.topics.iter().find(|(own, _)| own.get_ref() == topic);
        renamed.map_or(topic, |(_, name)| name.get_ref())
    }
    let stage = table.name.get_ref();
    let waits = |topic: &Spanned<String>| {
        let name = opened(table, topic.get_ref());
        // An injector between writer and readers writes the topic under its own name.
        let is_written = |written: &str| written == name || run::injected_topic(written) == Some(name);
        let mut written =
            tables.iter().flat_map(|other| other.writes.iter().map(|own| opened(other, own.get_ref())));
        (!written.any(is_written)).then(|| {
            format!(
                "the {stage} waits for the topic \"{name}\", which no stage writes: start the program that writes \
                 it, or correct `topics` of the {stage} or of the topic's writer"
            )
        })
    };
    table.reads.iter().filter_map(waits).collect()
}

/// Returns a warning if the sampler gives up waiting before the preceding stages stop serving agents.
fn late_controls(tables: &[&StageTable]) -> Option<String> {
    let sampler = tables.iter().find(|table| table.name.get_ref() == StageId::Sampler.name())?;
    let (_, deadline_ms) = sampler.options.iter().find(|(key, _)| key.get_ref() == "deadline_ms")?;
    let deadline_ms = match deadline_ms.get_ref() {
        toml::Value::Float(ms) => *ms,
        toml::Value::Integer(ms) => *ms as f64,
        _ => return None,
    };
    let is_before =
        |name: &str| StageId::from_name(name).is_some_and(|id| id.number() < StageId::Sampler.number());
    let before = tables.iter().filter(|table| is_before(table.name.get_ref()));
    let sum_ms: f64 = before.filter_map(|table| table.budget_ms.as_ref()).map(|ms| *ms.get_ref()).sum();
    (sum_ms > deadline_ms).then(|| {
        format!(
            "the budgets before the sampler add up to {sum_ms} ms, its deadline_ms is {deadline_ms}: where load is \
             shed, the decoder serves agents until their controls are too late"
        )
    })
}

/// Stages on a tick's way share one tick. Each of the other stages has a whole tick.
fn budgets(tables: &[&StageTable], way: &[&str]) -> Result<f64, Mistake> {
    let mut sum_ms = 0.0;
    for table in tables {
        let Some(budget) = &table.budget_ms else { continue };
        let ms = *budget.get_ref();
        if !(ms.is_finite() && ms > 0.0) {
            return Err(Mistake::new(
                budget.span(),
                "a budget must be a positive number of milliseconds",
                "here",
            ));
        }
        let is_beside = !way.contains(&table.name.get_ref().as_str());
        if is_beside && ms > BUDGET_MAX_MS {
            let message = format!("a budget of more than the {BUDGET_MAX_MS} ms of a tick");
            return Err(Mistake::new(budget.span(), message, format!("{ms} ms")));
        }
        sum_ms += if is_beside { 0.0 } else { ms };
        if sum_ms > BUDGET_MAX_MS {
            let message = format!("the budgets add up to more than the {BUDGET_MAX_MS} ms of a tick");
            return Err(Mistake::new(budget.span(), message, format!("{sum_ms} ms with this one")));
        }
    }
    Ok(sum_ms)
}
