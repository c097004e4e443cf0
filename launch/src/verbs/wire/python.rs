//! The table as a Python module: ctypes structures with the type names that iceoryx2 requires, and numpy
//! dtypes.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use ::wire::{Header, Primitive, Record, Table, Type, Value, data_id};

use super::text::{camel, capitals, plain, summary, wrapped};

const OPENING: &str = r#"
Nothing but Python is needed to import it. `TOPICS` has the elements of each topic's payload slices, with the type names
by which iceoryx2 connects; `DTYPES` the same layouts for numpy, empty where it is not installed:

    numpy.frombuffer(buffer, DTYPES[Forecast], count)
"""

import ctypes as c
import enum

try:
    import numpy
except ModuleNotFoundError:
    numpy = None

"#;

const CHECK: &str = r#"

def _check(record, size, offsets):
    """Refuses a machine on which a record does not lie as it does in stgdat."""
    found = {name: getattr(record, name).offset for name in offsets}
    if c.sizeof(record) != size or found != offsets:
        raise ImportError(f"{record.__name__} has {c.sizeof(record)} bytes, {found}, not {size}, {offsets}")
"#;

const DTYPES: &str = r#"
DTYPES = {} if numpy is None else {record: numpy.dtype(record) for record in RECORDS}
for _record, _dtype in DTYPES.items():
    if _dtype.itemsize != c.sizeof(_record) or any(
            _dtype.fields[name][1] != getattr(_record, name).offset for name in _dtype.names):
        raise ImportError(f"numpy lays {_record.__name__} out otherwise")
"#;

const PROTECTION: &str = r#"

def _crc64(data):
    """CRC-64/XZ of some bytes: the check value that the format .xz keeps of what it holds."""
    import lzma  # Some builds of Python lack it.

    fastest = {"id": lzma.FILTER_LZMA2, "preset": 0, "mf": lzma.MF_HC3, "nice_len": 3, "depth": 1}
    packed = lzma.compress(data, lzma.FORMAT_XZ, lzma.CHECK_CRC64, filters=[fastest])
    # Before the last 12 bytes lies the index, whose length they tell; before it the check value.
    index = 4 * (int.from_bytes(packed[-8:-4], "little") + 1)
    return int.from_bytes(packed[-20 - index:-12 - index], "little")


def protect(header, payload, topic, counter):
    """Protects a frame: the last thing before it is sent. `counter` counts the sender's frames."""
    payload = bytes(payload)
    header.protection = Protection(length=c.sizeof(header) + len(payload), counter=counter, data_id=DATA_IDS[topic])
    header.protection.crc = _crc64(bytes(header)[8:] + payload)


def is_intact(header, payload, topic):
    """Whether a frame is what its sender protected."""
    payload, protection = bytes(payload), header.protection
    sizes = c.sizeof(header) + len(payload), DATA_IDS[topic]
    return (protection.length, protection.data_id) == sizes and protection.crc == _crc64(bytes(header)[8:] + payload)
"#;

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

fn line(text: &mut String, line: &str) {
    writeln!(text, "{line}").expect("a string takes all");
}
