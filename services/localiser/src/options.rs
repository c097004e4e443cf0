use std::borrow::Cow;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use run::Declaration;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize, Serializer};
use thiserror::Error;
use wire::StageId;

use crate::Localiser;

/// The localiser.
pub const STAGE: Declaration<Options> = ports::declare::<Localiser, _>(StageId::Localiser);

/// What may be set of the localiser.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Context map: `online`, built from the tracks while the pipeline runs; `none`; or the path of a file
    /// that `stgdat map` wrote.
    pub map: MapChoice,
}

/// Where the context map comes from. As text `online`, `none` or a path.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum MapChoice {
    /// Built from the tracks while the pipeline runs, from the past only.
    #[default]
    Online,
    /// No map: every patch is zero.
    None,
    /// A file that `stgdat map` wrote.
    File(PathBuf),
}

/// The empty text, which names no map.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("no map")]
pub struct UnknownMap;

/// What may be written for a map.
const EXPECTED: &str = "online, none or the path of a map";

impl FromStr for MapChoice {
    type Err = UnknownMap;

    fn from_str(text: &str) -> Result<Self, UnknownMap> {
        match text {
            "online" => Ok(Self::Online),
            "none" => Ok(Self::None),
            "" => Err(UnknownMap),
            path => Ok(Self::File(path.into())),
        }
    }
}

impl TryFrom<String> for MapChoice {
    type Error = UnknownMap;

    fn try_from(text: String) -> Result<Self, UnknownMap> {
        text.parse()
    }
}

impl fmt::Display for MapChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Online => f.write_str("online"),
            Self::None => f.write_str("none"),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

impl Serialize for MapChoice {
    /// Fails if the path is not UTF-8.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::File(path) => path.serialize(serializer),
            named => named.to_string().serialize(serializer),
        }
    }
}

impl JsonSchema for MapChoice {
    fn schema_name() -> Cow<'static, str> {
        "MapChoice".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "expected": EXPECTED })
    }
}
