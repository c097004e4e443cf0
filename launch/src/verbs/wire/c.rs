//! The table as a header for C11 and C++17.

use std::fmt::Write as _;

use ::wire::{Header, Primitive, Record, Table, Type, Value, data_id};

use super::text::{capitals, plain, snake, summary, wrapped};

const OPENING: &str = r#"#ifndef STGDAT_WIRE_H
#define STGDAT_WIRE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define STGDAT_ASSERT(what, why) static_assert(what, why)
#else
#include <stdalign.h>
#define STGDAT_ASSERT(what, why) _Static_assert(what, why)
#endif

STGDAT_ASSERT(sizeof(float) == 4, "float has single precision");

"#;

const PROTECTION: &str = r#"
/* CRC-64/XZ of `length` bytes after `before`, the value of the bytes before them (0 at first). 16 entries of a table
   take half a byte each: 1 MB in about 3 ms; for more, any library's CRC-64/XZ does. */
static inline uint64_t stgdat_crc64(uint64_t before, const void *data, size_t length) {
    uint64_t table[16], crc = ~before;
    const unsigned char *bytes = (const unsigned char *)data;
    for (unsigned i = 0; i < 16; i++) {
        table[i] = i;
        for (int bit = 0; bit < 4; bit++) {
            table[i] = table[i] >> 1 ^ (table[i] & 1 ? UINT64_C(0xC96C5795D7870F42) : 0);
        }
    }
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

static inline uint64_t stgdat_frame_crc(const stgdat_header *header, const void *payload, size_t length) {
    const size_t own = sizeof header->protection.crc;
    uint64_t crc = stgdat_crc64(0, (const unsigned char *)header + own, sizeof *header - own);
    return stgdat_crc64(crc, payload, length);
}

/* Protects a frame: the last thing before it is sent. `length` is the payload's in bytes, `data_id` one of
   STGDAT_…_DATA_ID, and `counter` counts the sender's frames. */
static inline void stgdat_protect(
    stgdat_header *header, const void *payload, size_t length, uint32_t data_id, uint32_t counter) {
    const stgdat_protection protection = {0, (uint32_t)(sizeof *header + length), counter, data_id, {0}};
    header->protection = protection;
    header->protection.crc = stgdat_frame_crc(header, payload, length);
}

/* Whether a frame is what its sender protected: 1 or 0. */
static inline int stgdat_is_intact(
    const stgdat_header *header, const void *payload, size_t length, uint32_t data_id) {
    return header->protection.length == sizeof *header + length && header->protection.data_id == data_id
        && header->protection.crc == stgdat_frame_crc(header, payload, length);
}

"#;

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

fn line(text: &mut String, line: &str) {
    writeln!(text, "{line}").expect("a string takes all");
}
