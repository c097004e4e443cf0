//! The table as a Python module: ctypes structures with the type names that iceoryx2 requires, and numpy
//! dtypes.

use std::collections::BTreeMap;

use ::wire::{Header, Primitive, Record, Table, Type, Value, data_id};

use super::text::{camel, capitals, line, plain, summary, wrapped};

const OPENING: &str = include_str!("opening.py.in");
const CHECK: &str = include_str!("check.py.in");
const DTYPES: &str = include_str!("dtypes.py.in");
const PROTECTION: &str = include_str!("protection.py.in");

/// The module.
pub fn module(table: &Table) -> String {
    let mut text = format!(
        "\"\"\"The wire of stgdat, schema {}: what its topics carry through shared memory.\n\n\
         Printed by `stgdat wire --python`; not to be edited.\n{OPENING}",
        table.schema
    );
    constants(&mut text, table);
    text += CHECK;
    table.records.iter().for_each(|of| record(&mut text, table, of));
    topics(&mut text, table);
    text += PROTECTION;
    text += DTYPES;
    text
}

fn constants(text: &mut String, table: &Table) {
    for constant in table.constants {
        line(text, &format!("# {}", summary(constant.doc)));
        line(text, &format!("{} = {}", constant.name, literal(constant.value)));
    }
    for flags in table.flags {
        line(text, &format!("\n\nclass {}(enum.IntFlag):", camel(flags.name)));
        document(text, flags.doc);
        for bit in flags.bits {
            line(text, &format!("    {} = {}  # {}", bit.name, literal(bit.value), summary(bit.doc)));
        }
    }
    for numbers in table.numbers {
        line(text, &format!("\n\nclass {}(enum.IntEnum):", numbers.name));
        document(text, numbers.doc);
        for entry in numbers.entries {
            let (name, number) = (capitals(entry.name), entry.number);
            line(text, &format!("    {name} = {number}  # {}", summary(entry.doc)));
        }
    }
}

fn record(text: &mut String, table: &Table, record: &Record) {
    line(text, &format!("\n\nclass {}(c.Structure):", record.name));
    document(text, record.doc);
    if record.align > 8 {
        line(
            text,
            &format!("    _align_ = {}  # of Python 3.13 on; topics are aligned all the same", record.align),
        );
    }
    line(text, "    _fields_ = [");
    for field in record.fields {
        let (name, of) = (field.name, of(&field.r#type));
        line(text, &format!("        (\"{name}\", {of}),  # {}", summary(field.doc)));
    }
    line(text, "    ]\n");
    if let Some(name) = type_name(table, record) {
        named(text, name);
    }
    let offsets: Vec<String> =
        record.fields.iter().map(|field| format!("    \"{}\": {},", field.name, field.offset)).collect();
    line(text, &format!("\n_check({}, {}, {{\n{}\n}})", record.name, record.size, offsets.join("\n")));
}

/// Returns the type name of the header, or of a record that is the element of exactly one topic.
fn type_name(table: &Table, record: &Record) -> Option<&'static str> {
    let mut topics = table.topics.iter().filter(|topic| topic.element.name == record.name);
    match (topics.next(), topics.next()) {
        (Some(topic), None) => Some(topic.type_name),
        (None, _) if record.name == Header::RECORD.name => Some(Header::TYPE_NAME),
        _ => None,
    }
}

fn named(text: &mut String, type_name: &str) {
    line(text, "    @staticmethod\n    def type_name():");
    line(text, "        \"\"\"The name by which iceoryx2 knows it.\"\"\"");
    line(text, &format!("        return \"{type_name}\"\n"));
}

/// Writes a class's docstring.
fn document(text: &mut String, doc: &str) {
    line(text, &format!("    \"\"\"{}\"\"\"\n", wrapped(&plain(doc)).join("\n    ")));
}

fn topics(text: &mut String, table: &Table) {
    let mut elements = BTreeMap::new();
    text.push('\n');
    for topic in table.topics {
        let element = if type_name(table, topic.element).is_some() {
            topic.element.name.to_owned()
        } else {
            let name = camel(topic.name) + topic.element.name;
            line(text, &format!("\nclass {name}({}):", topic.element.name));
            document(text, topic.doc);
            named(text, topic.type_name);
            name
        };
        elements.insert(topic.name, element);
    }
    let names: Vec<&str> = table.records.iter().map(|record| record.name).collect();
    line(text, "\n# All records, each after those that it is made of.");
    line(text, &format!("RECORDS = [\n    {},\n]", names.join(",\n    ")));
    line(text, "\n# Elements by topic; the service of iceoryx2 is \"stgdat/NAME\".\nTOPICS = {");
    for topic in table.topics {
        line(text, &format!("    \"{}\": {},  # {}", topic.name, elements[topic.name], plain(topic.doc)));
    }
    line(text, "}");
    line(text, "\n# What `Protection.data_id` is on each topic.\nDATA_IDS = {");
    for topic in table.topics {
        line(text, &format!("    \"{}\": 0x{:08x},", topic.name, data_id(topic.name)));
    }
    line(text, "}");
}

fn of(of: &Type) -> String {
    match of {
        Type::Primitive(Primitive::F32) => "c.c_float".into(),
        Type::Primitive(Primitive::I64) => "c.c_int64".into(),
        Type::Primitive(unsigned) => format!("c.c_uint{}", 8 * unsigned.size()),
        Type::Record(record) => record.name.into(),
        Type::Array(part, len) => format!("{} * {len}", self::of(part)),
    }
}

fn literal(value: Value) -> String {
    match value {
        Value::Integer(value) => value.to_string(),
        Value::Real(value) => format!("{value:?}"),
    }
}
