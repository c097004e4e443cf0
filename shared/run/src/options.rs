//! The options of a stage as data, read from the schema of its struct.
//!
//! The struct derives `schemars::JsonSchema`. This module reads each option's description from the schema. In
//! addition to the keywords of JSON Schema, it reads two extensions, set by `#[schemars(extend("key" = …))]`:
//!
//! | key | value |
//! |---|---|
//! | `expected` | the expected value, if type and range do not describe it |
//! | `format` | `"path"` for the path of a file, which the launcher makes absolute |

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::Value as Json;

/// One option of a stage.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionSchema {
    /// The key.
    pub name: String,
    /// The documentation of its field.
    pub about: String,
    /// The kind of value that it takes.
    pub kind: &'static str,
    /// The expected value, worded to follow "expected".
    pub expected: String,
    /// The default as TOML; `None` if the option is unset by default.
    pub default: Option<String>,
    /// Whether its values are text, even if they look like numbers.
    pub is_text: bool,
    /// Whether its values are paths.
    pub is_path: bool,
    bounds: Bounds,
}

/// All options of a stage, in alphabetical order.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionsSchema(Vec<OptionSchema>);

/// Limits of a number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Bounds {
    least: Option<f64>,
    more_than: Option<f64>,
    most: Option<f64>,
    less_than: Option<f64>,
}

impl OptionsSchema {
    /// The options that are the fields of `O`.
    pub(crate) fn of<O: JsonSchema>() -> Self {
        let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
        let schema = settings.into_generator().into_root_schema_for::<O>().to_value();
        let fields = schema.get("properties").and_then(Json::as_object);
        Self(fields.into_iter().flatten().map(|(name, field)| OptionSchema::of(name, field)).collect())
    }

    /// The options.
    pub fn iter(&self) -> impl Iterator<Item = &OptionSchema> {
        self.0.iter()
    }

    /// The keys.
    pub fn names(&self) -> Vec<String> {
        self.iter().map(|option| option.name.clone()).collect()
    }

    /// The option with this key.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&OptionSchema> {
        self.iter().find(|option| option.name == name)
    }
}

impl OptionSchema {
    fn of(name: &str, field: &Json) -> Self {
        let text = |key: &str| field.get(key).and_then(Json::as_str).map(str::to_owned);
        let bounds = Bounds::of(field);
        let is_text = has_type(field, "string") || !names(field).is_empty();
        let default = field.get("default").filter(|default| !default.is_null());
        Self {
            name: name.to_owned(),
            // A sentence is broken into lines as in its source.
            about: text("description").unwrap_or_default().replace('\n', " "),
            kind: kind(field),
            expected: text("expected").unwrap_or_else(|| expected(field, &bounds)),
            default: default.map(ToString::to_string),
            is_text,
            is_path: is_path(field),
            bounds,
        }
    }

    /// Whether a number is within the option's range. Other values are always allowed.
    #[must_use]
    pub fn allows(&self, value: &toml::Value) -> bool {
        match value {
            toml::Value::Integer(number) => self.bounds.hold(*number as f64),
            toml::Value::Float(number) => self.bounds.hold(*number),
            _ => true,
        }
    }
}

impl Bounds {
    fn of(field: &Json) -> Self {
        let number = |key: &str| field.get(key).and_then(Json::as_f64);
        Self {
            least: number("minimum"),
            more_than: number("exclusiveMinimum"),
            most: number("maximum"),
            less_than: number("exclusiveMaximum"),
        }
    }

    fn hold(&self, number: f64) -> bool {
        self.least.is_none_or(|least| number >= least)
            && self.more_than.is_none_or(|limit| number > limit)
            && self.most.is_none_or(|most| number <= most)
            && self.less_than.is_none_or(|limit| number < limit)
    }

    /// The range in words; empty if there is none.
    fn words(&self) -> String {
        let lower = match (self.least, self.more_than) {
            (Some(least), None) => Some(format!("at least {least}")),
            (_, Some(limit)) => Some(format!("more than {limit}")),
            (None, None) => None,
        };
        let upper = match (self.most, self.less_than) {
            (Some(most), None) => Some(format!("at most {most}")),
            (_, Some(limit)) => Some(format!("less than {limit}")),
            (None, None) => None,
        };
        match (self.least, self.most) {
            (Some(least), Some(most)) => format!("{least} to {most}"),
            _ => lower.into_iter().chain(upper).collect::<Vec<_>>().join(" and "),
        }
    }
}

/// The expected value, described by type, names and range.
fn expected(field: &Json, bounds: &Bounds) -> String {
    let names = names(field);
    if let [others @ .., last] = &names[..] {
        return if others.is_empty() { last.clone() } else { format!("{} or {last}", others.join(", ")) };
    }
    let range = bounds.words();
    if !range.is_empty() {
        return range;
    }
    if has_type(field, "boolean") { "true or false".to_owned() } else { format!("a {}", kind(field)) }
}

/// The kind of a value.
fn kind(field: &Json) -> &'static str {
    if is_path(field) {
        return "path";
    }
    let kinds = [
        ("boolean", "truth value"),
        ("integer", "whole number"),
        ("number", "number"),
        ("string", "text"),
        ("array", "list"),
    ];
    if !names(field).is_empty() {
        return "name";
    }
    let kind = kinds.into_iter().find(|(kind, _)| has_type(field, kind));
    kind.map_or("value", |(_, words)| words)
}

/// The values of an enum.
fn names(field: &Json) -> Vec<String> {
    let list = |key: &str| field.get(key).and_then(Json::as_array).into_iter().flatten();
    let constants = ["oneOf", "anyOf"].into_iter().flat_map(list).flat_map(|variant| {
        let constant = variant.get("const").and_then(Json::as_str).map(str::to_owned);
        constant.into_iter().chain(names(variant))
    });
    list("enum").filter_map(Json::as_str).map(str::to_owned).chain(constants).collect()
}

fn is_path(field: &Json) -> bool {
    field.get("format").is_some_and(|format| format == "path")
}

fn has_type(field: &Json, name: &str) -> bool {
    match field.get("type") {
        Some(Json::String(kind)) => kind == name,
        Some(Json::Array(kinds)) => kinds.iter().any(|kind| kind == name),
        _ => false,
    }
}
