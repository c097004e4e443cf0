//! The table as a header for C11 and C++17.

use ::wire::{Header, Primitive, Record, Table, Type, Value, data_id};

use super::text::{capitals, line, plain, snake, summary, wrapped};

const OPENING: &str = include_str!("opening.h.in");
const PROTECTION: &str = include_str!("protection.h.in");

/// The header file.
pub fn header(table: &Table) -> String {
    let mut text = format!(
        "/* The wire of stgdat, schema {}: what its topics carry through shared memory.\n   \
         Printed by `stgdat wire --c`; not to be edited. */\n\n{OPENING}",
        table.schema
    );
    constants(&mut text, table);
    topics(&mut text, table);
    table.records.iter().for_each(|of| record(&mut text, of));
    text += PROTECTION;
    text += "#endif /* STGDAT_WIRE_H */\n";
    text
}

fn constants(text: &mut String, table: &Table) {
    for constant in table.constants {
        comment(text, "", &summary(constant.doc));
        line(text, &format!("#define STGDAT_{} {}", constant.name, literal(constant.value)));
    }
    for flags in table.flags {
        text.push('\n');
        comment(text, "", &plain(flags.doc));
        for bit in flags.bits {
            comment(text, "", &summary(bit.doc));
            let name = format!("STGDAT_{}_{}", flags.name.to_uppercase(), bit.name);
            line(text, &format!("#define {name} {}u", literal(bit.value)));
        }
    }
    for numbers in table.numbers {
        text.push('\n');
        comment(text, "", &plain(numbers.doc));
        line(text, &format!("enum stgdat_{} {{", snake(numbers.name)));
        for entry in numbers.entries {
            comment(text, "    ", &summary(entry.doc));
            let name = format!("STGDAT_{}_{}", capitals(numbers.name), capitals(entry.name));
            line(text, &format!("    {name} = {},", entry.number));
        }
        line(text, "};");
    }
}

fn topics(text: &mut String, table: &Table) {
    text.push('\n');
    comment(text, "", "Type name of the header.");
    line(text, &format!("#define STGDAT_HEADER_TYPE_NAME \"{}\"", Header::TYPE_NAME));
    for topic in table.topics {
        let name = capitals(topic.name);
        text.push('\n');
        comment(
            text,
            "",
            &format!(
                "{} Service \"stgdat/{}\", elements {}.",
                plain(topic.doc),
                topic.name,
                of_record(topic.element)
            ),
        );
        line(text, &format!("#define STGDAT_{name}_TYPE_NAME \"{}\"", topic.type_name));
        line(text, &format!("#define STGDAT_{name}_DATA_ID 0x{:08x}u", data_id(topic.name)));
        for (limit, value) in [
            ("ELEMENTS_MAX", topic.elements_max),
            ("PUBLISHERS_MAX", topic.publishers_max),
            ("SUBSCRIBERS_MAX", topic.subscribers_max),
            ("DEPTH_MAX", topic.depth_max),
        ] {
            line(text, &format!("#define STGDAT_{name}_{limit} {value}"));
        }
    }
}

fn record(text: &mut String, record: &Record) {
    let name = of_record(record);
    text.push('\n');
    comment(text, "", &plain(record.doc));
    line(text, &format!("typedef struct {name} {{"));
    // If a record is aligned more strictly than its fields, its first field carries the record's alignment.
    let of_fields = record.fields.iter().map(|field| field.r#type.align()).max();
    let more = of_fields < Some(record.align);
    let mut aligned = if more { format!("alignas({}) ", record.align) } else { String::new() };
    for field in record.fields {
        comment(text, "    ", &summary(field.doc));
        let (of, dimensions) = declaration(&field.r#type);
        line(text, &format!("    {aligned}{of} {}{dimensions};", field.name));
        aligned.clear();
    }
    line(text, &format!("}} {name};\n"));
    line(text, &format!("STGDAT_ASSERT(sizeof({name}) == {}, \"size of {name}\");", record.size));
    line(text, &format!("STGDAT_ASSERT(alignof({name}) == {}, \"alignment of {name}\");", record.align));
    for field in record.fields {
        let (field, offset) = (field.name, field.offset);
        line(text, &format!("STGDAT_ASSERT(offsetof({name}, {field}) == {offset}, \"{name}.{field}\");"));
    }
    text.push('\n');
}

fn of_record(record: &Record) -> String {
    format!("stgdat_{}", snake(record.name))
}

/// Returns a field's type, which precedes its name, and its dimensions, which follow the name.
fn declaration(of: &Type) -> (String, String) {
    match of {
        Type::Primitive(Primitive::F32) => ("float".into(), String::new()),
        Type::Primitive(Primitive::I64) => ("int64_t".into(), String::new()),
        Type::Primitive(unsigned) => (format!("uint{}_t", 8 * unsigned.size()), String::new()),
        Type::Record(record) => (of_record(record), String::new()),
        Type::Array(of, len) => {
            let (of, dimensions) = declaration(of);
            (of, format!("[{len}]{dimensions}"))
        }
    }
}

fn literal(value: Value) -> String {
    match value {
        Value::Integer(value) => value.to_string(),
        Value::Real(value) => format!("{value:?}f"),
    }
}

fn comment(text: &mut String, indent: &str, what: &str) {
    line(text, &format!("{indent}/* {} */", wrapped(what).join(&format!("\n{indent}   "))));
}
