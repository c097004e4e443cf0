//! What a ROS message is made of: its schema text in bags, and its type hash.

use std::fmt::Write as _;

use sha2::{Digest as _, Sha256};

/// A message type.
#[derive(Debug, PartialEq, Eq)]
pub struct Definition {
    /// Its name, such as `std_msgs/msg/Header`.
    pub name: &'static str,
    /// Its constants, as lines of the definition.
    pub constants: &'static [&'static str],
    /// Its fields, in their order.
    pub fields: &'static [(&'static str, Type)],
}

/// The type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Type {
    /// A primitive type.
    Primitive(Primitive),
    /// A message.
    Message(&'static Definition),
    /// An array of fixed length.
    Array(&'static Self, usize),
    /// A sequence.
    Sequence(&'static Self),
}

/// A primitive type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Primitive {
    /// Its name in definitions.
    pub name: &'static str,
    /// Its number in `type_description_interfaces/msg/FieldType`.
    pub id: u8,
}

/// Number of a nested message in `FieldType`.
const NESTED: u8 = 1;
/// Added to the number of an array's element.
const ARRAY: u8 = 48;
/// Added to the number of a sequence's element.
const SEQUENCE: u8 = 144;

impl Definition {
    /// The flattened definition: the schema of the encoding `ros2msg`.
    #[must_use]
    pub fn schema(&self) -> String {
        let mut text = self.lines();
        for nested in self.nested() {
            let name = short(nested.name);
            let _ = write!(text, "{}\nMSG: {name}\n{}", "=".repeat(80), nested.lines());
        }
        text
    }

    fn lines(&self) -> String {
        let mut text: String = self.constants.iter().map(|constant| format!("{constant}\n")).collect();
        for (name, of) in self.fields {
            let _ = writeln!(text, "{} {}", of.text(), bare(name));
        }
        text
    }

    /// All messages that it contains, each once.
    fn nested(&self) -> Vec<&'static Self> {
        let mut found = Vec::new();
        self.collect(&mut found);
        found
    }

    fn collect(&self, found: &mut Vec<&'static Self>) {
        for (_, of) in self.fields {
            if let Type::Message(nested) = of.element()
                && !found.contains(&nested)
            {
                found.push(nested);
                nested.collect(found);
            }
        }
    }

    /// The type hash of REP-2016: SHA-256 of a JSON document of all fields.
    #[must_use]
    pub fn hash(&self) -> String {
        let mut nested = self.nested();
        nested.sort_by_key(|nested| nested.name);
        let nested: Vec<String> = nested.into_iter().map(Self::description).collect();
        let json = format!(
            r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
            self.description(),
            nested.join(", ")
        );
        Sha256::digest(json).iter().fold("RIHS01_".to_owned(), |mut text, byte| {
            let _ = write!(text, "{byte:02x}");
            text
        })
    }

    fn description(&self) -> String {
        let fields = self.fields.iter().map(|(name, of)| {
            let (id, capacity, nested) = of.numbers();
            format!(
                r#"{{"name": "{}", "type": {{"type_id": {id}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}}}"#,
                bare(name)
            )
        });
        let fields: Vec<String> = fields.collect();
        format!(r#"{{"type_name": "{}", "fields": [{}]}}"#, self.name, fields.join(", "))
    }
}

impl Type {
    fn text(self) -> String {
        match self {
            Self::Primitive(primitive) => primitive.name.to_owned(),
            Self::Message(definition) => short(definition.name),
            Self::Array(of, len) => format!("{}[{len}]", of.text()),
            Self::Sequence(of) => format!("{}[]", of.text()),
        }
    }

    fn element(self) -> Self {
        match self {
            Self::Array(of, _) | Self::Sequence(of) => *of,
            of => of,
        }
    }

    /// Number, capacity and name of the nested message.
    fn numbers(self) -> (u8, usize, &'static str) {
        match self {
            Self::Primitive(primitive) => (primitive.id, 0, ""),
            Self::Message(definition) => (NESTED, 0, definition.name),
            Self::Array(of, len) => (of.numbers().0 + ARRAY, len, of.numbers().2),
            Self::Sequence(of) => (of.numbers().0 + SEQUENCE, 0, of.numbers().2),
        }
    }
}

/// The name as definitions write it: without `msg`.
fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

/// A field's name without the mark of Rust's keywords.
fn bare(name: &str) -> &str {
    name.trim_start_matches("r#")
}
