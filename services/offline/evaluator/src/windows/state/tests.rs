use std::sync::LazyLock;

use data::{GeneratedScene, SceneOptions};
use nn::Precision;
use proptest::prelude::*;

use super::*;
use crate::footage::Options;
use crate::windows::Evaluation;

/// The state of a generated recording of all types.
static ONE: LazyLock<State> = LazyLock::new(|| {
    let options = Options { threads: 2, ..Options::default() };
    let scene = SceneOptions { agents: 10, identities: true, ..SceneOptions::default() };
    let recording = GeneratedScene::new(scene).unwrap().recording(300);
    Evaluation::new(&options, false).unwrap().opened(recording)
});

/// The same state as if of another recording, with other errors.
fn copy(number: usize) -> State {
    let mut state = ONE.clone();
    let Parts::Each(parts) = &mut state.parts else { panic!("one recording is kept") };
    let [part] = &mut parts[..] else { panic!("one recording is kept") };
    let factor = 1.0 + 0.37 * (number as f64).sin();
    part.name = format!("road/{number:04}");
    part.sha256 = format!("{number:064x}");
    part.is_seen = number.is_multiple_of(5);
    part.tallies.iter_mut().for_each(|tally| *tally = tally.clone().scaled(factor));
    part.blocks.iter_mut().flatten().for_each(|block| *block = block.scaled(factor * factor));
    let count = DoubtCount { recordings: 1, rows: number as u64, of: 1000 };
    state.doubts = [("feet".to_owned(), count)].into();
    state.warnings = vec![format!("road/{number:04}: feet")];
    state.left_out = vec![format!("short/{number:04}")];
    state.basis.provenance.weights = format!("node{}/weights", number % 3);
    state
}

fn merged(states: impl IntoIterator<Item = State>) -> State {
    State::merged(states.into_iter().map(|state| Ok(("a state".to_owned(), state)))).unwrap()
}

/// Merges `states` in the order of `keys`, in parts, through bytes.
fn split(states: &[State], keys: &[(u32, usize)], parts: usize) -> State {
    let mut order: Vec<usize> = (0..states.len()).collect();
    order.sort_by_key(|place| keys[*place].0);
    let of_part = |part: usize| {
        let states: Vec<State> = order
            .iter()
            .filter(|place| keys[**place].1 % parts == part)
            .map(|p| states[*p].clone())
            .collect();
        (!states.is_empty()).then(|| {
            let bytes = merged(states).to_bytes();
            State::from_bytes("part", &bytes).unwrap()
        })
    };
    merged((0..parts).filter_map(of_part))
}

#[test]
fn a_state_has_blocks_and_all_types() {
    let Parts::Each(parts) = &ONE.parts else { panic!("one recording is kept") };
    assert!(parts[0].blocks.iter().all(|blocks| blocks.len() > 2));
    assert!(parts[0].tallies.iter().all(|tally| !tally.is_empty()));
    let bytes = ONE.to_bytes().len();
    // Half a minute with all types of agents.
    assert!(bytes < 40_000, "{bytes} bytes");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn every_split_and_order_gives_the_same_bytes(
        keys in proptest::collection::vec((any::<u32>(), any::<usize>()), 2..12),
        parts in 1..5_usize,
    ) {
        let states: Vec<State> = (0..keys.len()).map(copy).collect();
        let whole = merged(states.clone());
        let split = split(&states, &keys, parts);
        prop_assert!(split.to_bytes() == whole.to_bytes());
        prop_assert_eq!(split.report().csv(), whole.report().csv());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3))]
    #[test]
    fn splits_of_more_recordings_than_a_state_keeps_are_the_same(
        keys in proptest::collection::vec((any::<u32>(), any::<usize>()), RECORDINGS_MAX + 40),
        parts in 1..5_usize,
    ) {
        let states: Vec<State> = (0..keys.len()).map(copy).collect();
        let whole = merged(states.clone());
        prop_assert!(matches!(whole.parts, Parts::Total(_)));
        let split = split(&states, &keys, parts);
        prop_assert!(split.to_bytes() == whole.to_bytes());
    }
}

#[test]
fn many_recordings_have_the_means_and_nearly_the_intervals_of_single_ones() {
    let states: Vec<State> = (0..RECORDINGS_MAX).map(copy).collect();
    let each = merged(states.clone());
    let mut total = Total::default();
    let Parts::Each(parts) = &each.parts else { panic!("every recording is kept") };
    parts.iter().for_each(|part| total.add(part));
    let pooled = State { parts: Parts::Total(Box::new(total)), ..each.clone() };
    assert_eq!(pooled.recording_count(), each.recording_count());
    assert!(pooled.to_bytes().len() < each.to_bytes().len() / 3);
    let [each, pooled] = [each, pooled].map(|state| state.report());
    assert_eq!(each.brief(), pooled.brief());
    let of_all = each.figures.iter().filter(|figure| figure.part == "all");
    let mut interval_count = 0;
    for (expected, found) in of_all.zip(&pooled.figures) {
        assert!((expected.value - found.value).abs() < 1e-12, "{expected:?} {found:?}");
        assert_eq!((&expected.quantity, expected.agents), (&found.quantity, found.agents));
        if let (Some(expected), Some(found)) = (expected.interval, found.interval) {
            let width = expected[1] - expected[0];
            let apart = (0..2).map(|end| (expected[end] - found[end]).abs()).fold(0.0, f64::max);
            assert!(apart <= 0.15 * width, "{expected:?} {found:?}");
            interval_count += 1;
        }
    }
    assert!(interval_count > 10);
    assert_eq!(pooled.provenance.len(), 1);
    assert_eq!((pooled.provenance[0].recordings, pooled.provenance[0].seen_in_training), (256, 52));
}

#[test]
fn many_recordings_have_a_state_of_limited_size() {
    let of = |count: usize| {
        let mut whole = merged((0..count).map(copy));
        whole.left_out.clear();
        whole.to_bytes().len()
    };
    let (many, more) = (of(2 * RECORDINGS_MAX), of(8 * RECORDINGS_MAX));
    let bin = size_of::<BlockErrors>();
    assert!(more < 60_000 + COMPARED_SUBSETS * BLOCKS_MAX * bin, "{many} {more}");
}

#[test]
fn states_of_other_weights_options_and_versions_name_the_file() {
    let refused = |change: &dyn Fn(&mut Basis)| {
        let mut other = copy(1);
        change(&mut other.basis);
        let states = [("a.state", copy(0)), ("b.state", other)];
        let states = states.map(|(name, state)| Ok((name.to_owned(), state)));
        State::merged(states).unwrap_err().to_string()
    };
    assert!(
        refused(&|basis| basis.provenance.sha256 = "abc".to_owned())
            .starts_with("b.state: weights abc, but a.state has ")
    );
    assert_eq!(
        refused(&|basis| basis.provenance.map = "none".to_owned()),
        "b.state: map none, but a.state has online"
    );
    assert_eq!(
        refused(&|basis| basis.from_positions = true),
        "b.state: motion from positions, but a.state has as recorded"
    );
    assert_eq!(refused(&|basis| basis.lanes = true), "b.state: lanes used, but a.state has not used");
    assert!(
        refused(&|basis| basis.provenance.precision = Precision::Bf16)
            .contains("b.state: decoder.precision bf16")
    );

    let bytes = copy(0).to_bytes();
    let read = |bytes: &[u8]| State::from_bytes("a.state", bytes).unwrap_err();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let version = env!("CARGO_PKG_VERSION");
    let older = text.split_once('\n').unwrap().0.replace(version, "0.0.1") + "\n";
    let error = read(older.as_bytes());
    assert!(matches!(error, StateError::Version { .. }), "{error}");
    assert!(error.to_string().starts_with("a.state: a state of stgdat 0.0.1"), "{error}");
    assert!(matches!(read(&bytes[..bytes.len() - 1]), StateError::Damaged { .. }));
    let mut flipped = bytes.clone();
    flipped[200] ^= 1;
    assert!(matches!(read(&flipped), StateError::Damaged { .. }));
    for foreign in [&b""[..], b"stamp_s,id\n", b"stgdat-evaluation x\n"] {
        assert!(matches!(read(foreign), StateError::Foreign { .. }));
    }
    assert!(matches!(State::merged([]), Err(StateError::None)));
}
