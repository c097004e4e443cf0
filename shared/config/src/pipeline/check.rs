use std::collections::BTreeMap;
use std::ops::Range;
use std::str::FromStr;

use toml::Spanned;
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, StageId,
    Topic, TracksTopic, TruthTopic,
};

use super::error::Fault;
use super::file::{File, OptionsTable, StageTable};
use super::{Pipeline, Stage};
use crate::{Association, MapChoice, Options, Prior, Propagation, View};

/// What all budgets together may be: one tick.
pub const BUDGET_MAX_MS: f64 = 80.0;
/// Most threads that a stage may share its rows over.
const WORKERS_MAX: usize = 64;
/// Most particles per mode; the wire carries no more.
const PARTICLES_MAX: usize = 32;

/// The topics whose producer and consumers pipeline.toml tells.
const TOPICS: [&str; 8] = [
    DetectionsTopic::NAME,
    TruthTopic::NAME,
    TracksTopic::NAME,
    ContextTopic::NAME,
    FeaturesTopic::NAME,
    EncodingsTopic::NAME,
    ControlsTopic::NAME,
    ForecastsTopic::NAME,
];

/// The topics that this project's own program of a stage reads and writes.
#[must_use]
pub const fn built_in_topics(stage: StageId) -> (&'static [&'static str], &'static [&'static str]) {
    match stage {
        StageId::Source => (&[], &[DetectionsTopic::NAME, TruthTopic::NAME]),
        StageId::Tracker => (&[DetectionsTopic::NAME, ForecastsTopic::NAME], &[TracksTopic::NAME]),
        StageId::Localiser => (&[TracksTopic::NAME], &[ContextTopic::NAME]),
        StageId::Extractor => (&[ContextTopic::NAME], &[FeaturesTopic::NAME]),
        StageId::Encoder => (&[FeaturesTopic::NAME], &[EncodingsTopic::NAME]),
        StageId::Decoder => (&[EncodingsTopic::NAME], &[ControlsTopic::NAME]),
        StageId::Sampler => (&[TracksTopic::NAME, ControlsTopic::NAME], &[ForecastsTopic::NAME]),
        StageId::Recorder => (&[ForecastsTopic::NAME, TruthTopic::NAME], &[]),
    }
}

/// Checks stage by stage, then the graph as a whole.
pub(super) fn check(file: &File) -> Result<Pipeline, Fault> {
    let stages = file.stages.iter().map(Spanned::get_ref).map(stage).collect::<Result<Vec<_>, _>>()?;
    let tables: Vec<&StageTable> = file.stages.iter().map(Spanned::get_ref).collect();
    unique_names(&tables)?;
    producers(file)?;
    acyclic(&tables)?;
    budgets(&tables)?;
    for needed in [StageId::Source, StageId::Sampler, StageId::Recorder] {
        if !stages.iter().any(|s| s.id == needed) {
            let message = format!("there is no stage \"{}\"", needed.name());
            return Err(Fault::new(0..0, message, "needed in every pipeline"));
        }
    }
    Ok(Pipeline { weights: file.weights.clone(), stages })
}

fn stage(table: &StageTable) -> Result<Stage, Fault> {
    let name = table.name.get_ref();
    let id = StageId::from_name(name).ok_or_else(|| {
        let known = StageId::ALL.map(StageId::name).join(", ");
        Fault::new(table.name.span(), format!("unknown stage \"{name}\""), "no stage has this name")
            .help(format!("the stages are {known}; `command` puts another program in a stage's place"))
    })?;
    for topic in table.reads.iter().chain(&table.writes) {
        if !TOPICS.contains(&topic.get_ref().as_str()) {
            let message = format!("unknown topic \"{}\"", topic.get_ref());
            return Err(Fault::new(topic.span(), message, "no topic has this name")
                .help(format!("the topics are {}", TOPICS.join(", "))));
        }
    }
    if let Some(command) = table.command.as_ref().filter(|c| c.get_ref().is_empty()) {
        return Err(Fault::new(
            command.span(),
            "`command` is empty",
            "expected [\"program\", \"argument\", …]",
        ));
    }
    if table.command.is_none() {
        built_in(id, table)?;
    }
    Ok(Stage {
        id,
        command: table.command.as_ref().map(|c| c.get_ref().clone()),
        reads: names(&table.reads),
        writes: names(&table.writes),
        budget_ms: table.budget_ms.as_ref().map(|ms| *ms.get_ref()),
        options: options(id, &table.options)?,
    })
}

fn names(topics: &[Spanned<String>]) -> Vec<String> {
    topics.iter().map(|t| t.get_ref().clone()).collect()
}

/// This project's own programs speak fixed topics: a file that tells others would not be what runs.
fn built_in(id: StageId, table: &StageTable) -> Result<(), Fault> {
    let (reads, writes) = built_in_topics(id);
    for (key, told, real) in [("reads", &table.reads, reads), ("writes", &table.writes, writes)] {
        let wrong = told.iter().find(|t| !real.contains(&t.get_ref().as_str()));
        let missing = real.iter().find(|r| !told.iter().any(|t| t.get_ref() == *r));
        let (span, label) = match (wrong, missing) {
            (Some(topic), _) => (topic.span(), format!("the {} does not {} it", id.name(), verb(key))),
            (None, Some(topic)) => (table.name.span(), format!("its program also {key} \"{topic}\"")),
            (None, None) => continue,
        };
        let message = format!("`{key}` is not what the {} {key}", id.name());
        return Err(Fault::new(span, message, label).help(format!("{key} = {real:?}, or give a `command`")));
    }
    Ok(())
}

fn verb(key: &str) -> &str {
    key.trim_end_matches('s')
}

fn options(id: StageId, table: &OptionsTable) -> Result<Options, Fault> {
    let foreign = |span: Range<usize>, key: &str, of: &str| {
        let message = format!("the {} has no option `{key}`", id.name());
        Err(Fault::new(span, message, format!("an option of the {of}")))
    };
    let range = |span: Range<usize>, key: &str, expected: String| {
        Err(Fault::new(span, format!("`{key}` is out of range"), format!("expected {expected}")))
    };
    match &table.deadline_ms {
        Some(ms) if id != StageId::Sampler => return foreign(ms.span(), "deadline_ms", "sampler"),
        Some(ms) if !(*ms.get_ref() > 0.0 && *ms.get_ref() <= BUDGET_MAX_MS) => {
            return range(ms.span(), "deadline_ms", format!("more than 0 and at most {BUDGET_MAX_MS}"));
        }
        _ => {}
    }
    match &table.workers {
        Some(n) if !matches!(id, StageId::Extractor | StageId::Decoder) => {
            return foreign(n.span(), "workers", "extractor and the decoder");
        }
        Some(n) if !(1..=WORKERS_MAX).contains(n.get_ref()) => {
            return range(n.span(), "workers", format!("1 to {WORKERS_MAX}"));
        }
        _ => {}
    }
    match &table.particles {
        Some(n) if id != StageId::Sampler => return foreign(n.span(), "particles", "sampler"),
        Some(n) if !(1..=PARTICLES_MAX).contains(n.get_ref()) => {
            return range(n.span(), "particles", format!("1 to {PARTICLES_MAX}"));
        }
        _ => {}
    }
    if let Some(map) = table.map.as_ref().filter(|_| id != StageId::Localiser) {
        return foreign(map.span(), "map", "localiser");
    }
    if let Some(prior) = table.prior.as_ref().filter(|_| id != StageId::Tracker) {
        return foreign(prior.span(), "prior", "tracker");
    }
    if let Some(association) = table.association.as_ref().filter(|_| id != StageId::Tracker) {
        return foreign(association.span(), "association", "tracker");
    }
    if let Some(view) = table.view.as_ref().filter(|_| id != StageId::Tracker) {
        return foreign(view.span(), "view", "tracker");
    }
    if let Some(recall) = table.recall.as_ref().filter(|_| id != StageId::Sampler) {
        return foreign(recall.span(), "recall", "sampler");
    }
    if let Some(memory) = table.memory.as_ref().filter(|_| id != StageId::Sampler) {
        return foreign(memory.span(), "memory", "sampler");
    }
    if let (Some(memory), Some(recall)) = (&table.memory, &table.recall)
        && !recall.get_ref()
    {
        let message = "a memory that is not to be recalled".to_owned();
        return Err(Fault::new(memory.span(), message, "`recall` is false"));
    }
    if let Some(propagation) = table.propagation.as_ref().filter(|_| id != StageId::Sampler) {
        return foreign(propagation.span(), "propagation", "sampler");
    }
    Ok(Options {
        deadline_ms: table.deadline_ms.as_ref().map(|ms| *ms.get_ref()),
        workers: table.workers.as_ref().map(|n| *n.get_ref()),
        map: parsed::<MapChoice>(table.map.as_ref())?,
        prior: parsed::<Prior>(table.prior.as_ref())?,
        association: parsed::<Association>(table.association.as_ref())?,
        view: parsed::<View>(table.view.as_ref())?,
        recall: table.recall.as_ref().map(|recall| *recall.get_ref()),
        memory: table.memory.as_ref().map(|memory| memory.get_ref().clone()),
        propagation: parsed::<Propagation>(table.propagation.as_ref())?,
        particles: table.particles.as_ref().map(|n| *n.get_ref()),
    })
}

fn parsed<T: FromStr<Err: ToString>>(text: Option<&Spanned<String>>) -> Result<Option<T>, Fault> {
    text.map(|t| t.get_ref().parse().map_err(|e: T::Err| Fault::new(t.span(), e.to_string(), "here")))
        .transpose()
}

fn unique_names(tables: &[&StageTable]) -> Result<(), Fault> {
    for (i, table) in tables.iter().enumerate() {
        if tables[..i].iter().any(|earlier| earlier.name == table.name) {
            let message = format!("the stage \"{}\" is there twice", table.name.get_ref());
            return Err(Fault::new(table.name.span(), message, "named before"));
        }
    }
    Ok(())
}

fn producers(file: &File) -> Result<(), Fault> {
    let mut producer: BTreeMap<&str, &str> = BTreeMap::new();
    let tables = || file.stages.iter().map(Spanned::get_ref);
    for table in tables() {
        for topic in &table.writes {
            if let Some(other) = producer.insert(topic.get_ref(), table.name.get_ref()) {
                let message = format!("\"{}\" is written by two stages", topic.get_ref());
                return Err(Fault::new(topic.span(), message, format!("the {other} writes it already")));
            }
        }
    }
    match tables().flat_map(|t| &t.reads).find(|t| !producer.contains_key(t.get_ref().as_str())) {
        Some(topic) => {
            let message = format!("no stage writes \"{}\"", topic.get_ref());
            Err(Fault::new(topic.span(), message, "read here"))
        }
        None => Ok(()),
    }
}

/// Takes away, one by one, the stages whose inputs are all made by stages taken away before; what stays waits for itself.
fn acyclic(tables: &[&StageTable]) -> Result<(), Fault> {
    let mut open = tables.to_vec();
    while let Some(ready) = open.iter().position(|table| open_input(table, &open).is_none()) {
        open.remove(ready);
    }
    let Some((stage, topic)) = open.first().and_then(|stage| Some((stage, open_input(stage, &open)?))) else {
        return Ok(());
    };
    let message = format!("the {} waits for itself", stage.name.get_ref());
    let label = format!("\"{}\" is made from what this stage writes", topic.get_ref());
    Err(Fault::new(topic.span(), message, label)
        .help("the only loop that is allowed is the tracker reading \"forecasts\""))
}

/// The first input of a stage that one of the open stages writes. The tracker reads the forecasts of earlier ticks: that
/// loop is meant.
fn open_input<'a>(table: &'a StageTable, open: &[&StageTable]) -> Option<&'a Spanned<String>> {
    table.reads.iter().find(|read| {
        let topic = read.get_ref();
        let meant = table.name.get_ref() == "tracker" && topic == ForecastsTopic::NAME;
        !meant && open.iter().any(|other| other.writes.iter().any(|written| written.get_ref() == topic))
    })
}

fn budgets(tables: &[&StageTable]) -> Result<(), Fault> {
    let mut sum_ms = 0.0;
    for budget in tables.iter().filter_map(|t| t.budget_ms.as_ref()) {
        let ms = *budget.get_ref();
        if !(ms.is_finite() && ms > 0.0) {
            return Err(Fault::new(
                budget.span(),
                "a budget must be a positive number of milliseconds",
                "here",
            ));
        }
        sum_ms += ms;
        if sum_ms > BUDGET_MAX_MS {
            let message = format!("the budgets add up to more than the {BUDGET_MAX_MS} ms of a tick");
            return Err(Fault::new(budget.span(), message, format!("{sum_ms} ms with this one")));
        }
    }
    Ok(())
}
