//! Records in which all numbers differ, to show the position of each number.

use std::fmt::Write as _;

use crate::{
    AgentControls, AgentEncoding, AgentFeatures, ControlGaussian, Counts, Detection, Edge, Forecast, Header,
    Heartbeat, HistoryState, Hop, InputCounts, Layout, Protection, Record, Row, Track, Truth, Type,
};

/// Something whose numbers can be made distinct.
pub(crate) trait Distinct {
    /// Sets its numbers to `next` and the following values, in source order.
    fn number(&mut self, next: &mut u32);
}

macro_rules! primitives {
    ($($type:ty),+) => {
        $(impl Distinct for $type {
            fn number(&mut self, next: &mut u32) {
                *self = *next as $type;
                *next += 1;
            }
        })+
    };
}

primitives!(u8, u16, u32, u64, i64, f32);

impl<T: Distinct, const N: usize> Distinct for [T; N] {
    fn number(&mut self, next: &mut u32) {
        self.iter_mut().for_each(|element| element.number(next));
    }
}

/// A record's bytes, with a line for each field; for arrays and records, a line for each part.
fn dump<T: Layout + Default + Distinct>(record: &Record) -> String {
    let mut value = T::default();
    value.number(&mut 1);
    let mut text = format!("{} bytes, aligned {}\n", record.size, record.align);
    for field in record.fields {
        write_lines(&mut text, field.name, field.offset, &field.r#type, bytemuck::bytes_of(&value));
    }
    text
}

fn write_lines(text: &mut String, name: &str, offset: usize, of: &Type, bytes: &[u8]) {
    match of {
        Type::Record(record) => {
            for field in record.fields {
                let name = format!("{name}.{}", field.name);
                write_lines(text, &name, offset + field.offset, &field.r#type, bytes);
            }
        }
        // Rows of numbers fit on a line.
        Type::Array(row, len) if !matches!(row, Type::Primitive(_)) => {
            for place in 0..*len {
                write_lines(text, &format!("{name}[{place}]"), offset + place * row.size(), row, bytes);
            }
        }
        Type::Array(..) | Type::Primitive(_) => {
            let hex: String = bytes[offset..][..of.size()].iter().map(|byte| format!("{byte:02x}")).collect();
            writeln!(text, "{offset:5} {name} {hex}").expect("a string takes all");
        }
    }
}

macro_rules! snapshots {
    ($($test:ident: $record:ident),+ $(,)?) => {
        $(#[test]
        fn $test() {
            insta::assert_snapshot!(dump::<$record>(&$record::RECORD));
        })+
    };
}

mod bytes_of {
    use super::*;

    snapshots! {
        protection: Protection,
        hop: Hop,
        counts: Counts,
        input_counts: InputCounts,
        header: Header,
        detection: Detection,
        truth: Truth,
        history_state: HistoryState,
        track: Track,
        row: Row,
        agent_features: AgentFeatures,
        edge: Edge,
        agent_encoding: AgentEncoding,
        control_gaussian: ControlGaussian,
        agent_controls: AgentControls,
        forecast: Forecast,
        heartbeat: Heartbeat,
    }
}
