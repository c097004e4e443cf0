use super::*;

/// A field of a message, as the tests' own decoder reads it.
#[derive(Clone, Debug, PartialEq)]
enum Field {
    Varint(u64),
    Fixed(u64),
    Bytes(Vec<u8>),
}

fn varint(bytes: &mut &[u8]) -> u64 {
    let mut value = 0;
    for place in 0.. {
        let (&byte, rest) = bytes.split_first().expect("a varint ends");
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << (7 * place);
        if byte < 0x80 {
            break;
        }
    }
    value
}

fn fields(mut bytes: &[u8]) -> Vec<(u64, Field)> {
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let field = match key & 7 {
            0 => Field::Varint(varint(&mut bytes)),
            1 => {
                let (value, rest) = bytes.split_at(8);
                bytes = rest;
                Field::Fixed(u64::from_le_bytes(value.try_into().unwrap()))
            }
            2 => {
                let len = varint(&mut bytes) as usize;
                let (value, rest) = bytes.split_at(len);
                bytes = rest;
                Field::Bytes(value.to_vec())
            }
            wire => panic!("wire type {wire}"),
        };
        fields.push((key >> 3, field));
    }
    fields
}

/// The contents of every submessage with this field number.
fn inner(message: &[(u64, Field)], number: u64) -> Vec<Vec<(u64, Field)>> {
    let of = |(found, field): &(u64, Field)| match field {
        Field::Bytes(bytes) if *found == number => Some(fields(bytes)),
        _ => None,
    };
    message.iter().filter_map(of).collect()
}

fn packets(trace: &Trace) -> Vec<Vec<(u64, Field)>> {
    inner(&fields(trace.bytes()), 1)
}

#[test]
fn a_span_is_a_begin_and_an_end_on_the_monotonic_clock() {
    let mut trace = Trace::default();
    let values = [("tick", Value::Count(300)), ("ms", Value::Number(0.5)), ("why", Value::Text("late"))];
    let details = Details { category: Some("tick"), flow: Some(7), values: &values, ..Details::default() };
    trace.span(5, [1_000, 2_000], "compute", details);
    let packets = packets(&trace);
    assert_eq!(packets.len(), 2);
    for (packet, [at_ns, kind]) in packets.iter().zip([[1_000, 1], [2_000, 2]]) {
        assert!(packet.contains(&(8, Field::Varint(at_ns))) && packet.contains(&(58, Field::Varint(3))));
        let event = &inner(packet, 11)[0];
        assert!(event.contains(&(9, Field::Varint(kind))) && event.contains(&(11, Field::Varint(5))));
    }
    let event = &inner(&packets[0], 11)[0];
    assert!(event.contains(&(23, Field::Bytes(b"compute".to_vec()))));
    assert!(event.contains(&(47, Field::Fixed(7))));
    let values = inner(event, 4);
    assert_eq!(values.len(), 3);
    assert!(values[0].contains(&(3, Field::Varint(300))));
    assert!(values[1].contains(&(5, Field::Fixed(0.5_f64.to_bits()))));
    assert!(values[2].contains(&(6, Field::Bytes(b"late".to_vec()))));
}

#[test]
fn clocks_and_tracks_are_told() {
    let mut trace = Trace::default();
    trace.clocks(Clocks { monotonic_ns: 10, boottime_ns: 12, realtime_ns: None });
    trace.process(1, 2_000_000_000, "decoder", 6);
    trace.counter(2, 1, "agents", "agents", 0);
    let packets = packets(&trace);
    let clocks = inner(&inner(&packets[0], 6)[0], 1);
    let pairs: Vec<Vec<Field>> =
        clocks.iter().map(|clock| clock.iter().map(|(_, field)| field.clone()).collect()).collect();
    assert_eq!(pairs, [[Field::Varint(3), Field::Varint(10)], [Field::Varint(6), Field::Varint(12)]]);
    let process = &inner(&inner(&packets[1], 60)[0], 3)[0];
    assert!(process.contains(&(1, Field::Varint(2_000_000_000))));
    assert_eq!(inner(&inner(&packets[2], 60)[0], 8).len(), 1);
}

#[test]
fn a_span_never_ends_before_it_begins() {
    let mut trace = Trace::default();
    trace.span(1, [2_000, 1_000], "late", Details::default());
    assert!(packets(&trace).iter().all(|packet| packet.contains(&(8, Field::Varint(2_000)))));
}

#[test]
fn what_is_taken_can_be_joined() {
    let (mut whole, mut parts) = (Trace::default(), Trace::with_room(64));
    let mut joined = Vec::new();
    for at_ns in 0..10 {
        whole.instant(1, at_ns, "mark", Details::default());
        parts.instant(1, at_ns, "mark", Details::default());
        joined.extend(parts.take());
    }
    assert_eq!(joined, whole.bytes());
}
