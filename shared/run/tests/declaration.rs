//! A stage's options are checked, described and read by its struct alone.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::path::PathBuf;

use run::options::OptionSchema;
use run::{Conflict, Declaration, Declared, NoOptions, OptionError, Run, StageRun};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::StageId;

/// Options of every type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Options {
    /// Time to wait, in
    /// milliseconds.
    #[schemars(range(max = 80.0), extend("exclusiveMinimum" = 0.0))]
    deadline_ms: f64,
    /// Threads.
    #[schemars(range(min = 1, max = 64))]
    workers: usize,
    /// Ticks.
    #[schemars(range(min = 1))]
    ticks: Option<u64>,
    /// Whether.
    active: bool,
    /// A way.
    way: Way,
    /// A file.
    #[schemars(extend("format" = "path"))]
    file: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Way {
    /// There.
    #[default]
    Forward,
    /// And back.
    ThereAndBack,
}

impl Default for Options {
    fn default() -> Self {
        Self { deadline_ms: 72.0, workers: 1, ticks: None, active: true, way: Way::Forward, file: None }
    }
}

impl Options {
    fn check(&self) -> Result<(), Conflict> {
        match &self.file {
            Some(_) if !self.active => {
                Err(Conflict { key: "file", reason: "a file for nothing", because: "`active` is false" })
            }
            _ => Ok(()),
        }
    }
}

const STAGE: Declaration<Options> =
    Declaration::new(StageId::Sampler, &["tracks"], &["forecasts"]).with_rule(Options::check);

/// Message and advice for a table; `None` if the table is accepted.
fn refusal(table: &str) -> Option<(String, String)> {
    let refused = STAGE.check(&table.parse().unwrap()).err()?;
    assert!(refused.key().is_some_and(|key| table.contains(key)), "{refused:?}");
    Some((refused.to_string(), refused.advice()))
}

#[test]
fn every_option_is_described_by_its_field() {
    let schema = STAGE.schema();
    let described = |name: &str| {
        let OptionSchema { about, expected, default, .. } = schema.get(name).unwrap();
        (about.clone(), expected.clone(), default.clone().unwrap_or_default())
    };
    let expected = [
        ("active", "Whether.", "true or false", "true"),
        ("deadline_ms", "Time to wait, in milliseconds.", "more than 0 and at most 80", "72.0"),
        ("file", "A file.", "a path", ""),
        ("ticks", "Ticks.", "at least 1", ""),
        ("way", "A way.", "forward or there-and-back", "\"forward\""),
        ("workers", "Threads.", "1 to 64", "1"),
    ];
    assert_eq!(schema.names(), expected.map(|(name, ..)| name));
    for (name, about, words, default) in expected {
        assert_eq!(described(name), (about.into(), words.into(), default.into()), "{name}");
    }
    let of_kind = |kind: fn(&OptionSchema) -> bool| {
        schema.iter().filter(|option| kind(option)).map(|option| option.name.clone()).collect::<Vec<_>>()
    };
    let kinds: Vec<&str> = schema.iter().map(|option| option.kind).collect();
    assert_eq!(kinds, ["truth value", "number", "path", "whole number", "name", "whole number"]);
    assert_eq!(of_kind(|option| option.is_path), ["file"]);
    assert_eq!(of_kind(|option| option.is_text), ["file", "way"]);
}

#[test]
fn values_in_their_ranges_are_accepted() {
    for table in [
        "",
        "deadline_ms = 80",
        "deadline_ms = 0.5\nworkers = 64\nticks = 1",
        "way = \"there-and-back\"\nactive = true\nfile = \"a.txt\"",
    ] {
        assert_eq!(refusal(table), None, "{table}");
    }
}

#[test]
fn wrong_values_are_refused_with_advice() {
    let cases = [
        ("speed = 3", "the sampler has no option `speed`", "its options are active, deadline_ms, "),
        ("deadline_ms = 0", "`deadline_ms` is out of range", "expected more than 0 and at most 80"),
        ("deadline_ms = 80.1", "`deadline_ms` is out of range", "expected more than 0 and at most 80"),
        ("deadline_ms = nan", "`deadline_ms` is out of range", "expected more than 0 and at most 80"),
        ("workers = 65", "`workers` is out of range", "expected 1 to 64"),
        ("workers = 0", "`workers` is out of range", "expected 1 to 64"),
        ("workers = -1", "`workers` of the sampler: ", "expected 1 to 64"),
        ("workers = 1.5", "`workers` of the sampler: ", "expected 1 to 64"),
        ("ticks = 0", "`ticks` is out of range", "expected at least 1"),
        ("active = \"yes\"", "`active` of the sampler: ", "expected true or false"),
        (
            "way = \"back\"",
            "`way` of the sampler: unknown variant `back`",
            "expected forward or there-and-back",
        ),
        ("file = 3", "`file` of the sampler: ", "expected a path"),
        ("file = \"a\"\nactive = false", "a file for nothing", "`active` is false"),
    ];
    for (table, message, advice) in cases {
        let (refused, advised) = refusal(table).unwrap_or_else(|| panic!("{table} is accepted"));
        assert!(refused.starts_with(message) && advised.starts_with(advice), "{table}: {refused}: {advised}");
    }
}

#[test]
fn a_stage_reads_its_options_from_the_runs_record() {
    let of = |stages: Vec<StageRun>| STAGE.options(&Run { stages, ..Run::default() });
    assert_eq!(of(Vec::new()), Ok(Options::default()));
    let options = Options { workers: 3, file: Some("a b".into()), ..Options::default() };
    let stage = StageRun::with_options(&STAGE, &options).unwrap();
    assert_eq!(of(vec![stage.clone()]), Ok(options));
    let written = |options: &str| of(vec![StageRun { options: options.into(), ..stage.clone() }]);
    assert_eq!(written(""), Ok(Options::default()));
    let unknown = written("workres = 3").unwrap_err().to_string();
    assert!(unknown.contains("`workres = 3` of the sampler: unknown field `workres`"), "{unknown}");
    let placed = StageRun {
        options: "active = true\nworkers = \"two\"".into(),
        places: [("workers".to_owned(), "mine.toml:12".to_owned())].into(),
        ..stage.clone()
    };
    let wrong = of(vec![placed]).unwrap_err().to_string();
    assert!(wrong.starts_with("mine.toml:12: `workers = \"two\"` of the sampler: invalid type"), "{wrong}");
    assert!(matches!(written("active = false\nfile = \"a\""), Err(OptionError::Conflict(_))));
}

#[test]
fn a_stage_without_options_has_none() {
    const NONE: Declaration<NoOptions> = Declaration::new(StageId::Encoder, &[], &[]);
    assert_eq!(NONE.schema().names(), Vec::<String>::new());
    assert_eq!(NONE.check(&toml::Table::new()), Ok(()));
    let refused = NONE.check(&"workers = 1".parse().unwrap()).unwrap_err();
    assert_eq!(refused.advice(), "it has none");
}
