//! Topics and stages that the file adds to the shipped ones.

use std::ops::Range;

use console::mistake::Mistake;
use run::{TopicRun, injected_topic};
use toml::Spanned;
use wire::{ADDED_STAGES_MAX, ADDED_TOPICS_MAX, ELEMENT_SIZE_MAX, StageId, TABLE, TopicEntry};

use super::file::{File, StageTable};

/// Longest name of a stage or topic, in bytes.
const NAME_MAX: usize = 32;
/// Longest name of a type, in bytes.
const TYPE_NAME_MAX: usize = 128;
/// Names of a run's processes that are not stages.
const TAKEN: [&str; 7] = ["launcher", "tap", "cleaner", "injector", "consumer", "stgdat", "heartbeats"];

/// The topics that the file declares.
pub(super) fn topics(file: &File) -> Result<Vec<TopicRun>, Mistake> {
    let mut topics: Vec<TopicRun> = Vec::new();
    for topic in &file.topics {
        let (span, topic) = (topic.span(), topic.get_ref());
        let (name, type_name) = (topic.name.get_ref(), topic.type_name.get_ref());
        plain(&topic.name, "topic")?;
        if injected_topic(name).is_some() {
            let message = format!("\"{name}\" can't be the name of a topic");
            return Err(Mistake::new(
                topic.name.span(),
                message,
                "a name that an injector gives: expected another end",
            ));
        }
        if shipped(name).is_some() {
            let message = format!("\"{name}\" is a topic of the pipeline's own");
            return Err(Mistake::new(topic.name.span(), message, "expected another name"));
        }
        if topics.iter().any(|other| other.name == *name) {
            let message = format!("the topic \"{name}\" is declared twice");
            return Err(Mistake::new(topic.name.span(), message, "declared before"));
        }
        if topics.len() == ADDED_TOPICS_MAX {
            let message = format!("more than {ADDED_TOPICS_MAX} topics are declared");
            return Err(Mistake::new(span, message, "one too many"));
        }
        let is_printed = |c: char| c.is_ascii_graphic();
        if type_name.is_empty() || type_name.len() > TYPE_NAME_MAX || !type_name.chars().all(is_printed) {
            let message = format!("\"{type_name}\" can't be the name of a type");
            let advice = format!("expected 1 to {TYPE_NAME_MAX} letters, digits and signs, without spaces");
            return Err(Mistake::new(topic.type_name.span(), message, advice));
        }
        let element_size = element_size(&topic.element_bytes, type_name)?;
        topics.push(TopicRun { name: name.clone(), type_name: type_name.clone(), element_size });
    }
    Ok(topics)
}

/// The size of an element. It must be within its limit, and equal to the size of a shipped type.
fn element_size(bytes: &Spanned<u64>, type_name: &str) -> Result<usize, Mistake> {
    let found = *bytes.get_ref();
    let size = usize::try_from(found).ok().filter(|size| (1..=ELEMENT_SIZE_MAX).contains(size));
    let Some(size) = size else {
        let message = format!("an element of {found} bytes");
        return Err(Mistake::new(bytes.span(), message, format!("expected 1 to {ELEMENT_SIZE_MAX}")));
    };
    match TABLE.topics.iter().find(|topic| topic.type_name == type_name) {
        Some(known) if known.element.size != size => {
            let (name, size) = (known.element.name, known.element.size);
            let message = format!("\"{type_name}\" is the type of {name}, of another size");
            Err(Mistake::new(bytes.span(), message, format!("expected {size}")))
        }
        _ => Ok(size),
    }
}

/// The shipped topic of this name.
pub(super) fn shipped(name: &str) -> Option<&'static TopicEntry> {
    TABLE.topics.iter().find(|topic| topic.name == name)
}

/// The number of this table's stage. A stage that is not shipped is the `added_count`th stage that the file
/// adds.
pub(super) fn stage_id(table: &StageTable, added_count: usize) -> Result<StageId, Mistake> {
    let name = table.name.get_ref();
    if let Some(id) = StageId::ALL.into_iter().find(|id| id.name() == name) {
        return Ok(id);
    }
    if table.command.is_none() {
        let known = StageId::ALL.map(StageId::name).join(", ");
        let message = format!("unknown stage \"{name}\"");
        return Err(Mistake::new(table.name.span(), message, "no stage has this name").help(format!(
            "the stages are {known}; `command` puts another program in a stage's place, or adds a stage of your own"
        )));
    }
    plain(&table.name, "stage")?;
    StageId::added(added_count).ok_or_else(|| {
        let message = format!("more than {ADDED_STAGES_MAX} stages are added");
        Mistake::new(table.name.span(), message, "one too many")
    })
}

/// Refuses a text that cannot be a name in shared memory, on a command line and in a table.
pub(super) fn plain(name: &Spanned<String>, of: &str) -> Result<(), Mistake> {
    let (text, span): (&str, Range<usize>) = (name.get_ref(), name.span());
    let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if text.is_empty() || text.len() > NAME_MAX || !text.chars().all(is_plain) {
        let message = format!("\"{text}\" can't be the name of a {of}");
        let advice = format!("expected 1 to {NAME_MAX} lower case letters, digits, \"-\" and \"_\"");
        return Err(Mistake::new(span, message, advice));
    }
    if TAKEN.contains(&text) {
        let message = format!("the name \"{text}\" is taken");
        return Err(Mistake::new(span, message, "expected another name"));
    }
    Ok(())
}

/// The name in shared memory of a stage's topic.
pub(super) fn name_of<'a>(table: &'a StageTable, topic: &'a str, declared: &[TopicRun]) -> &'a str {
    let renamed = table.topics.iter().find(|(from, _)| from.get_ref() == topic);
    renamed.and_then(|(_, to)| declared_name(to.get_ref(), declared)).unwrap_or(topic)
}

/// The declared topic that a stage opens by this name. The name is either the topic's name or the name of an
/// injector behind it. Any other name belongs to a program between two stages, which the file does not show;
/// the file then treats the topic as the stage's own.
pub(super) fn declared_name<'a>(name: &'a str, declared: &[TopicRun]) -> Option<&'a str> {
    let names = [Some(name), injected_topic(name)].into_iter().flatten();
    names.into_iter().find(|name| declared.iter().any(|topic| topic.name == **name))
}

/// Refuses a declared topic that no stage writes.
pub(super) fn written(file: &File, declared: &[TopicRun]) -> Result<(), Mistake> {
    for topic in &file.topics {
        let name = topic.get_ref().name.get_ref();
        let writes = |table: &StageTable| {
            table.writes.iter().any(|topic| name_of(table, topic.get_ref(), declared) == name)
        };
        if !file.stages.iter().any(|table| writes(table.get_ref())) {
            let message = format!("no stage writes \"{name}\"");
            return Err(Mistake::new(topic.get_ref().name.span(), message, "declared here"));
        }
    }
    Ok(())
}
