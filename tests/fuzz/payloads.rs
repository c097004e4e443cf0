//! Fuzz targets for all input through shared memory: headers, elements and sections. Any byte of these can be
//! wrong.
//!
//! Each target writes words of the fuzzer into a good element, at the places of its numbers or anywhere.
//! Checks must not panic. An element that they accept has only finite numbers, and its counts and indices are
//! within their limits. The sections of `context` and `features` are read with headers of any sizes.
//!
//! `readers.rs` has the command for a longer search.

use bytemuck::{Pod, Zeroable};
use wire::{
    AgentControls, AgentEncoding, AgentFeatures, Context, ContextShape, Detection, Edge, FeatureShape,
    Features, FeaturesMut, Forecast, Header, MODES_MAX, POSITION_MAX_M, Primitive, Record, Rejected, Row,
    StageId, Track, context_rows, feature_rows,
};

/// Iterations of a target in an ordinary test run.
const ITERATIONS: usize = 20_000;
/// Longest list of edits, in bytes.
const EDITS_BYTES_MAX: usize = 70;
/// Values that often break checks.
const WORDS: [u32; 12] = [
    0,
    1,
    u32::MAX,
    1 << 31,
    0x7F80_0000,
    0xFF80_0000,
    0x7FC0_0000,
    0x7F7F_FFFF,
    0x0000_0001,
    0x4700_0001,
    128,
    1 << 20,
];

/// Applies edits of seven bytes each: position (two bytes), kind, and value (four bytes).
fn edit(record: &mut [u8], edits: &[u8]) {
    for edit in edits.chunks_exact(7) {
        let [low, high, how, word @ ..] = edit else { continue };
        let place = usize::from(u16::from_le_bytes([*low, *high])) % (record.len() - 3);
        let place = if how % 4 == 0 { place } else { place / 4 * 4 };
        match how % 3 {
            0 => record[place..place + 4].copy_from_slice(word),
            _ => record[place..place + 4]
                .copy_from_slice(&WORDS[usize::from(word[0]) % WORDS.len()].to_le_bytes()),
        }
    }
}

/// Edits a good element. If the check accepts the result, it has finite numbers and satisfies `invariant`.
fn fuzz<T: Pod + Send + Sync + std::panic::RefUnwindSafe>(
    record: &Record,
    good: T,
    check: fn(&T) -> Result<(), Rejected>,
    invariant: fn(&T),
) {
    check(&good).unwrap_or_else(|why| panic!("a good {}: {why}", record.name));
    let leaves = record.leaves();
    let reals: Vec<usize> =
        leaves.iter().filter(|leaf| leaf.primitive == Primitive::F32).map(|leaf| leaf.offset).collect();
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|edits: &[u8]| {
        let mut edited = good;
        edit(bytemuck::bytes_of_mut(&mut edited), edits);
        if check(&edited).is_ok() {
            let bytes = bytemuck::bytes_of(&edited);
            let real = |place: usize| f32::from_le_bytes([0, 1, 2, 3].map(|byte| bytes[place + byte]));
            assert!(reals.iter().all(|&place| real(place).is_finite()), "{bytes:?}");
            invariant(&edited);
        }
    });
}

fn is_near(position_m: [f32; 2]) -> bool {
    position_m.iter().all(|x| x.abs() <= POSITION_MAX_M)
}

#[test]
fn detection() {
    fuzz(&Detection::RECORD, Detection::default(), Detection::check, |detection| {
        assert!(detection.agent_type().is_ok() && is_near([detection.x_m, detection.y_m]));
        assert!(detection.length_m >= 0.0 && detection.width_m >= 0.0 && detection.sigma_m >= 0.0);
    });
}

#[test]
fn track() {
    fuzz(&Track::RECORD, Track::default(), Track::check, |track| {
        assert!(track.agent_type().is_ok() && is_near([track.x_m, track.y_m]));
        assert!(track.history.iter().all(|state| is_near([state.x_m, state.y_m])));
    });
}

#[test]
fn features() {
    fuzz(&AgentFeatures::RECORD, AgentFeatures::default(), |a| a.check(wire::HISTORY_MAX), |_| ());
}

#[test]
fn encoding() {
    fuzz(&AgentEncoding::RECORD, AgentEncoding::default(), |a| a.check(wire::HISTORY_MAX), |_| ());
}

#[test]
fn controls() {
    let good = AgentControls { modes_len: 20, ..AgentControls::default() };
    fuzz(&AgentControls::RECORD, good, AgentControls::check, |controls| {
        assert!((1..=MODES_MAX).contains(&(controls.modes_len as usize)));
    });
}

#[test]
fn forecast() {
    fuzz(&Forecast::RECORD, Forecast::default(), Forecast::check, |forecast| {
        assert!(is_near([forecast.x_m, forecast.y_m]));
    });
}

/// A header of any bytes describes sections that fit their payload, or is refused.
#[test]
fn header_and_sections() {
    let mut good = Header::new(1, 2, 3);
    (good.counts.agents_len, good.counts.history_len, good.hops_len) = (2, 8, 3);
    (good.counts.patch_side, good.counts.edges_len) = (4, 5);
    let shapes = (ContextShape::of(&good.counts), FeatureShape::of(&good.counts));
    let context = vec![Row::zeroed(); context_rows(&shapes.0)];
    let mut features = vec![Row::zeroed(); feature_rows(&shapes.1)];
    let sections = FeaturesMut::over(&mut features, shapes.1).expect("the rows are as many");
    for (step, edge) in sections.edges.iter_mut().enumerate() {
        *edge = Edge { step: step as u16, receiver: 1, sender: step as u16 % 2, reserved: 0 };
    }
    assert!(Features::read(&features, shapes.1, 8).is_ok());
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|edits: &[u8]| {
        let mut header = good;
        edit(bytemuck::bytes_of_mut(&mut header), edits);
        assert!(header.hops().len() <= header.hops.len());
        let mut passed_on = header;
        passed_on.push_hop(wire::Hop::default());
        let _ = passed_on.hop(StageId::Source);
        if header.check().is_err() {
            return;
        }
        let mut rows = features.clone();
        edit(bytemuck::cast_slice_mut(&mut rows), edits);
        let history_len = header.counts.history_len as usize;
        if let Ok(read) = Features::read(&rows, FeatureShape::of(&header.counts), history_len) {
            let agents_len = read.agents.len();
            assert!(read.edges.iter().all(|edge| usize::from(edge.sender) < agents_len));
            assert!(read.edges.is_sorted() && read.attributes.len() == read.edges.len());
        }
        if let Ok(read) = Context::read(&context, ContextShape::of(&header.counts)) {
            let last = (read.tracks.len(), history_len);
            let patch = (last.0 > 0 && last.1 > 0).then(|| read.patch(last.0 - 1, last.1 - 1).len());
            assert!(patch.is_none_or(|len| len == read.shape.patch_len()));
        }
    });
}
