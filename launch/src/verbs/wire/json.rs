//! The table as JSON, for generators of other languages.

use ::wire::{Constant, Field, Header, Record, Table, Type, Value};
use serde_json::{Value as Json, json};

use super::text::plain;

/// The document.
pub fn document(table: &Table) -> String {
    let document = json!({
        "schema": table.schema,
        "header": { "record": Header::RECORD.name, "type_name": Header::TYPE_NAME },
        "constants": table.constants.iter().map(constant).collect::<Vec<_>>(),
        "flags": table.flags.iter().map(|flags| json!({
            "name": flags.name,
            "doc": plain(flags.doc),
            "bits": flags.bits.iter().map(constant).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "numbers": table.numbers.iter().map(|numbers| json!({
            "name": numbers.name,
            "doc": plain(numbers.doc),
            "entries": numbers.entries.iter().map(|entry| {
                json!({ "name": entry.name, "doc": plain(entry.doc), "number": entry.number })
            }).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "records": table.records.iter().map(record).collect::<Vec<_>>(),
        "topics": table.topics.iter().map(|topic| json!({
            "name": topic.name,
            "doc": plain(topic.doc),
            "type_name": topic.type_name,
            "element": topic.element.name,
            "elements_max": topic.elements_max,
            "publishers_max": topic.publishers_max,
            "subscribers_max": topic.subscribers_max,
            "depth_max": topic.depth_max,
        })).collect::<Vec<_>>(),
    });
    format!("{document:#}\n")
}

fn constant(constant: &Constant) -> Json {
    let value = match constant.value {
        Value::Integer(value) => json!(value),
        Value::Real(value) => json!(value),
    };
    json!({ "name": constant.name, "doc": plain(constant.doc), "value": value })
}

fn record(record: &Record) -> Json {
    let field = |field: &Field| {
        json!({
            "name": field.name,
            "doc": plain(field.doc),
            "offset": field.offset,
            "type": of(&field.r#type),
        })
    };
    json!({
        "name": record.name,
        "doc": plain(record.doc),
        "size": record.size,
        "align": record.align,
        "fields": record.fields.iter().map(field).collect::<Vec<_>>(),
    })
}

/// Writes a primitive as its name, and a record or an array as an object.
fn of(of: &Type) -> Json {
    match of {
        Type::Primitive(primitive) => json!(primitive.name()),
        Type::Array(part, len) => json!({ "array": self::of(part), "len": len }),
        Type::Record(record) => json!({ "record": record.name }),
    }
}
