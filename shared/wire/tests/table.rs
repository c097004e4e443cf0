//! The guarantees of the table for programs in other languages; the checks of payloads cover every number.

use std::collections::BTreeSet;

use bytemuck::Pod;
use wire::{
    AgentControls, AgentEncoding, AgentFeatures, Detection, Forecast, Header, Leaf, Primitive, Record,
    Rejected, SCHEMA, TABLE, Topic, Track, Type,
};

fn records_in(of: &Type) -> Option<&Record> {
    match of {
        Type::Primitive(_) => None,
        Type::Array(of, _) => records_in(of),
        Type::Record(record) => Some(record),
    }
}

#[test]
fn records_have_no_gaps_and_follow_those_that_they_are_made_of() {
    let mut known = BTreeSet::new();
    for record in TABLE.records {
        let mut end = 0;
        for field in record.fields {
            assert_eq!(field.offset, end, "{}.{}", record.name, field.name);
            assert_eq!(field.offset % field.r#type.align(), 0, "{}.{}", record.name, field.name);
            assert!(!field.doc.is_empty() && !record.doc.is_empty());
            end += field.r#type.size();
            let part = records_in(&field.r#type);
            assert!(part.is_none_or(|part| known.contains(part.name)), "{}.{}", record.name, field.name);
        }
        assert_eq!(end, record.size, "{}", record.name);
        assert_eq!(record.size % record.align, 0, "{}", record.name);
        assert!(known.insert(record.name), "two records {}", record.name);
    }
    assert!(TABLE.topics.iter().all(|topic| known.contains(topic.element.name)));
}

#[test]
fn one_number_is_the_version_of_everything() {
    assert_eq!(TABLE.schema, SCHEMA);
    assert_eq!(Header::TYPE_NAME, format!("stgdat.header.{SCHEMA}"));
    for topic in TABLE.topics {
        assert_eq!(topic.type_name, format!("stgdat.{}.{SCHEMA}", topic.name));
    }
    assert_eq!(wire::TracksTopic::TYPE_NAME, "stgdat.tracks.2");
    assert_eq!(Header::new(1, 2, 3).schema, SCHEMA);
}

#[test]
fn numbers_and_flags_ascend_and_have_names_of_their_own() {
    for numbers in TABLE.numbers {
        assert!(numbers.entries.is_sorted_by(|a, b| a.number < b.number), "{}", numbers.name);
        let names: BTreeSet<_> = numbers.entries.iter().map(|entry| entry.name).collect();
        assert_eq!(names.len(), numbers.entries.len(), "{}", numbers.name);
    }
    for flags in TABLE.flags {
        let bits = flags.bits.iter().map(|bit| match bit.value {
            wire::Value::Integer(value) => value,
            wire::Value::Real(_) => 0,
        });
        assert!(bits.clone().all(|bit| bit.is_power_of_two() && bit <= u64::from(u32::MAX)));
        assert!(bits.is_sorted_by(|a, b| a < b), "{}", flags.name);
    }
    let constant = |name: &str| TABLE.constants.iter().find(|constant| constant.name == name).unwrap().value;
    assert_eq!(constant("AGENTS_MAX"), wire::Value::Integer(wire::AGENTS_MAX as u64));
    assert_eq!(constant("POSITION_MAX_M"), wire::Value::Real(wire::POSITION_MAX_M));
}

/// A valid record is refused if any one of its numbers is NaN or infinite.
fn assert_no_number_is_overlooked<T: Pod>(
    record: &Record,
    good: T,
    check: impl Fn(&T) -> Result<(), Rejected>,
) {
    assert_eq!(check(&good), Ok(()), "{}", record.name);
    let leaves = record.leaves();
    let reals = leaves.iter().filter(|leaf| leaf.primitive == Primitive::F32);
    assert!(reals.clone().count() > 0);
    for Leaf { path, offset, .. } in reals {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut off = good;
            bytemuck::bytes_of_mut(&mut off)[*offset..offset + 4].copy_from_slice(&value.to_ne_bytes());
            assert!(check(&off).is_err(), "{}.{path} = {value}", record.name);
        }
    }
}

#[test]
fn checks_overlook_no_number_that_is_not_finite() {
    assert_no_number_is_overlooked(&Header::RECORD, Header::new(1, 2, 3), Header::check);
    assert_no_number_is_overlooked(&Detection::RECORD, Detection::default(), Detection::check);
    assert_no_number_is_overlooked(&Track::RECORD, Track::default(), Track::check);
    assert_no_number_is_overlooked(&AgentFeatures::RECORD, AgentFeatures::default(), |a| a.check(8));
    assert_no_number_is_overlooked(&AgentEncoding::RECORD, AgentEncoding::default(), |a| a.check(8));
    let controls = AgentControls { modes_len: 1, ..AgentControls::default() };
    assert_no_number_is_overlooked(&AgentControls::RECORD, controls, AgentControls::check);
    assert_no_number_is_overlooked(&Forecast::RECORD, Forecast::default(), Forecast::check);
}
