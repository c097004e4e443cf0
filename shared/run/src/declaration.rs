use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::{ForecastsTopic, StageId, Topic};

use crate::options::OptionsSchema;
use crate::{Run, StageRun};

/// A stage in one constant: its id, the topics of its program, and the struct of its options.
pub struct Declaration<O> {
    /// `None` for a stage that a pipeline file adds. The process that runs the stage gets the id from its
    /// environment.
    id: Option<StageId>,
    reads: &'static [&'static str],
    writes: &'static [&'static str],
    rule: fn(&O) -> Result<(), Conflict>,
}

/// The declaration of any stage, regardless of the type of its options.
pub trait Declared: fmt::Debug + Sync {
    /// The stage's id.
    fn id(&self) -> StageId;
    /// The topics that its program reads.
    fn reads(&self) -> &'static [&'static str];
    /// The topics that its program writes.
    fn writes(&self) -> &'static [&'static str];
    /// The options.
    fn schema(&self) -> OptionsSchema;
    /// Refuses a table of options with which the program would not start.
    ///
    /// # Errors
    /// [`OptionError`] names the first key that is wrong.
    fn check(&self, table: &toml::Table) -> Result<(), OptionError>;
}

/// Two options that exclude each other.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{reason}")]
pub struct Conflict {
    /// Key of the option at fault.
    pub key: &'static str,
    /// The reason.
    pub reason: &'static str,
    /// The other setting, which rules it out.
    pub because: &'static str,
}

/// Why a stage's options cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OptionError {
    /// The stage has no such option.
    #[error("the {} has no option `{key}`", stage.name())]
    Unknown {
        /// The stage.
        stage: StageId,
        /// The key.
        key: String,
        /// The existing keys.
        known: Vec<String>,
    },
    /// The value does not have the option's type.
    #[error("`{key}` of the {}: {}", stage.name(), first_line(source))]
    Invalid {
        /// The stage.
        stage: StageId,
        /// The key.
        key: String,
        /// The error of the option's type.
        source: Box<toml::de::Error>,
        /// The expected value.
        expected: String,
    },
    /// The number is outside the option's range.
    #[error("`{key}` is out of range")]
    OutOfRange {
        /// The key.
        key: String,
        /// The expected value.
        expected: String,
    },
    /// The values exclude each other.
    #[error(transparent)]
    Conflict(#[from] Conflict),
    /// An option in the run's record that this program cannot read.
    #[error("{place}`{key} = {value}` of the {}: {}", stage.name(), first_line(source))]
    Refused {
        /// The stage.
        stage: StageId,
        /// The key.
        key: String,
        /// The value.
        value: String,
        /// The file and the line, or the argument, before ": "; empty if unknown.
        place: String,
        /// The error of the option's type.
        source: Box<toml::de::Error>,
    },
    /// The run's record has options that this program cannot read.
    #[error("options of the {}: {}", stage.name(), first_line(source))]
    Unreadable {
        /// The stage.
        stage: StageId,
        /// The parser's error.
        source: Box<toml::de::Error>,
    },
    /// TOML cannot represent the options.
    #[error("options of the {}: {source}", stage.name())]
    Unwritable {
        /// The stage.
        stage: StageId,
        /// The writer's error.
        source: toml::ser::Error,
    },
}

/// The message without the excerpt of the text. The text is not a file that a user wrote.
fn first_line(error: &toml::de::Error) -> &str {
    error.message().lines().next().unwrap_or_default()
}

impl OptionError {
    /// The key at fault, if the error concerns a key.
    pub fn key(&self) -> Option<&str> {
        match self {
            Self::Unknown { key, .. }
            | Self::Invalid { key, .. }
            | Self::OutOfRange { key, .. }
            | Self::Refused { key, .. } => Some(key),
            Self::Conflict(conflict) => Some(conflict.key),
            Self::Unreadable { .. } | Self::Unwritable { .. } => None,
        }
    }

    /// The valid choices, as part of a sentence or a list.
    pub fn advice(&self) -> String {
        match self {
            Self::Unknown { known, .. } if known.is_empty() => "it has none".to_owned(),
            Self::Unknown { known, .. } => format!("its options are {}", known.join(", ")),
            Self::Invalid { expected, .. } | Self::OutOfRange { expected, .. } => {
                format!("expected {expected}")
            }
            Self::Conflict(conflict) => conflict.because.to_owned(),
            Self::Refused { .. } => "the stage's program declares its options".to_owned(),
            Self::Unreadable { .. } => "launcher and stage must be of one version".to_owned(),
            Self::Unwritable { .. } => "paths must be UTF-8".to_owned(),
        }
    }
}

/// Whether a stage reads the frames of earlier ticks from a topic, which a later stage writes. This is the only
/// loop of the pipeline's graph: a forecast is the tracker's prior in later ticks.
#[must_use]
pub fn is_feedback(stage: StageId, topic: &str) -> bool {
    stage == StageId::Tracker && topic == ForecastsTopic::NAME
}

/// The environment variable that holds the name of a process's stage. The names of added stages are known
/// only after the run's record has been read.
pub const STAGE_VARIABLE: &str = "STGDAT_STAGE";

/// The stage as which this process was started, from its environment; `None` if there is none.
#[must_use]
pub fn own_stage() -> Option<StageId> {
    StageId::from_name(&std::env::var(STAGE_VARIABLE).ok()?)
}

/// The options of a stage without options.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NoOptions {}

impl<O> fmt::Debug for Declaration<O> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, reads, writes, .. } = self;
        f.debug_struct("Declaration").field("id", id).field("reads", reads).field("writes", writes).finish()
    }
}

impl<O> Declaration<O> {
    /// A stage whose program reads and writes the topics of these names.
    #[must_use]
    pub const fn new(id: StageId, reads: &'static [&'static str], writes: &'static [&'static str]) -> Self {
        Self { id: Some(id), reads, writes, rule: |_| Ok(()) }
    }

    /// A stage that a pipeline file adds. The file sets its name. The topics are the ones that the program
    /// opens, under the program's own names.
    #[must_use]
    pub const fn added(reads: &'static [&'static str], writes: &'static [&'static str]) -> Self {
        Self { id: None, reads, writes, rule: |_| Ok(()) }
    }

    /// Adds a rule that involves several options.
    #[must_use]
    pub const fn with_rule(self, rule: fn(&O) -> Result<(), Conflict>) -> Self {
        Self { rule, ..self }
    }

    /// The stage's id. For an added stage this is the id that this process runs as ([`own_stage`]).
    ///
    /// # Panics
    /// If the stage is an added one and this process was not started as a stage.
    pub fn id(&self) -> StageId {
        self.id.or_else(own_stage).unwrap_or_else(|| panic!("{STAGE_VARIABLE} names no stage of this run"))
    }

    /// The topics that its program reads.
    pub const fn reads(&self) -> &'static [&'static str] {
        self.reads
    }

    /// The topics that its program writes.
    pub const fn writes(&self) -> &'static [&'static str] {
        self.writes
    }
}

fn parsed<O: DeserializeOwned>(table: &toml::Table) -> Result<O, toml::de::Error> {
    toml::Value::Table(table.clone()).try_into()
}

/// The first option whose key or value does not fit the struct `O`.
fn first_refused<O: DeserializeOwned>(
    table: &toml::Table,
) -> Option<(&String, &toml::Value, toml::de::Error)> {
    table.iter().find_map(|(key, value)| {
        let error = parsed::<O>(&toml::Table::from_iter([(key.clone(), value.clone())])).err()?;
        // A struct without defaults needs its other options, too.
        (!error.message().starts_with("missing field")).then_some((key, value, error))
    })
}

impl<O: Default + DeserializeOwned> Declaration<O> {
    /// The stage's options in a run, or the defaults if the run does not have the stage.
    ///
    /// # Errors
    /// [`OptionError::Refused`] names the first option that this program does not have or whose type is
    /// wrong, [`OptionError::Unreadable`] if an option is missing, [`OptionError::Conflict`] if the options
    /// exclude each other.
    pub fn options(&self, run: &Run) -> Result<O, OptionError> {
        let id = self.id();
        let Some(stage) = run.stage(id) else { return Ok(O::default()) };
        let unreadable = |error: toml::de::Error| OptionError::Unreadable { stage: id, source: error.into() };
        let table: toml::Table = stage.options.parse().map_err(unreadable)?;
        let options = parsed(&table).map_err(|error| match first_refused::<O>(&table) {
            Some((key, value, source)) => {
                let place = stage.places.get(key).map_or_else(String::new, |place| format!("{place}: "));
                let (key, value) = (key.clone(), value.to_string());
                OptionError::Refused { stage: id, key, value, place, source: source.into() }
            }
            None => unreadable(error),
        })?;
        (self.rule)(&options)?;
        Ok(options)
    }
}

impl<O: DeserializeOwned + JsonSchema> Declared for Declaration<O> {
    fn id(&self) -> StageId {
        self.id()
    }

    fn reads(&self) -> &'static [&'static str] {
        self.reads
    }

    fn writes(&self) -> &'static [&'static str] {
        self.writes
    }

    fn schema(&self) -> OptionsSchema {
        OptionsSchema::of::<O>()
    }

    fn check(&self, table: &toml::Table) -> Result<(), OptionError> {
        let (stage, schema) = (self.id(), self.schema());
        for (key, value) in table {
            let Some(option) = schema.get(key) else {
                return Err(OptionError::Unknown { stage, key: key.clone(), known: schema.names() });
            };
            let expected = option.expected.clone();
            // One option at a time, so that an error belongs to this option.
            if let Err(error) = parsed::<O>(&toml::Table::from_iter([(key.clone(), value.clone())])) {
                let source = Box::new(error);
                return Err(OptionError::Invalid { stage, key: key.clone(), source, expected });
            }
            if !option.allows(value) {
                return Err(OptionError::OutOfRange { key: key.clone(), expected });
            }
        }
        let options =
            parsed(table).map_err(|error| OptionError::Unreadable { stage, source: error.into() })?;
        Ok((self.rule)(&options)?)
    }
}

impl StageRun {
    /// This project's own program of a stage, with these options and without a share of the tick.
    ///
    /// # Errors
    /// [`OptionError::Unwritable`] if TOML cannot represent the options because a path is not UTF-8.
    pub fn with_options<O: Serialize>(
        declaration: &Declaration<O>,
        options: &O,
    ) -> Result<Self, OptionError> {
        let stage = declaration.id();
        let options = toml::to_string(options).map_err(|source| OptionError::Unwritable { stage, source })?;
        Ok(Self {
            stage: stage.number(),
            budget_ms: None,
            built_in: true,
            options,
            name: String::new(),
            program: String::new(),
            places: BTreeMap::new(),
            reads: Vec::new(),
            writes: Vec::new(),
        })
    }
}
