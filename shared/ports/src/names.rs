//! Topics under other names. They allow a program between a writer and its readers.

use std::collections::BTreeMap;

/// The environment variable with the topics that this process opens under another name: a list of
/// `topic=name`. Its launcher sets it from the key `topics` of the stage in pipeline.toml.
pub const TOPICS_VARIABLE: &str = "STGDAT_TOPICS";

/// Names of topics in shared memory that differ from the topics' own names.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Names(BTreeMap<String, String>);

impl Names {
    /// The names of this process.
    pub fn of_process() -> Self {
        std::env::var(TOPICS_VARIABLE).map_or_else(|_| Self::default(), |list| Self::read(&list))
    }

    /// Parses a list of `topic=name`.
    fn read(list: &str) -> Self {
        let pairs = list.split(',').filter_map(|pair| pair.split_once('='));
        Self(pairs.map(|(topic, name)| (topic.trim().to_owned(), name.trim().to_owned())).collect())
    }

    /// A topic's name in shared memory.
    pub fn of<'a>(&'a self, topic: &'a str) -> &'a str {
        self.0.get(topic).map_or(topic, String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_keeps_its_name_unless_the_list_has_another() {
        let names = Names::read("tracks=tracks-raw, controls = b");
        assert_eq!(
            (names.of("tracks"), names.of("controls"), names.of("context")),
            ("tracks-raw", "b", "context")
        );
        assert_eq!(Names::read(""), Names::default());
    }
}
