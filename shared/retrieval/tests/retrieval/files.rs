//! Memory files: a written file is read back, and invalid files are refused.

use std::path::Path;

use crate::passing::{HORIZON_LEN, STEP_NS, after, at_x, retrieve};
use proptest::prelude::*;
use retrieval::{BicycleKey, DisplacementKey, Key, MemoryError, Query, RetrievalMemory, Retrieved};
use scene::FileError;

/// The weights whose forecasts are stored.
const WEIGHTS: &str = "0123456789abcdef";
/// Number and length of their steps.
const STEPS: (usize, u64) = (HORIZON_LEN, STEP_NS);

/// The key of an agent near the origin, and its positions at the following steps.
fn passage() -> impl Strategy<Value = (Key, Vec<[f32; 2]>)> {
    let near = || [-9.0_f32..9.0, -9.0_f32..9.0];
    let bicycle = (near(), -3.0_f32..3.0, 1.0_f32..9.0, -2.0_f32..2.0, -0.3_f32..0.3).prop_map(
        |(position_m, heading_rad, speed_mps, acceleration_mps2, turn_rate_radps)| {
            Key::Bicycle(BicycleKey {
                position_m,
                heading_rad,
                speed_mps,
                acceleration_mps2,
                turn_rate_radps,
            })
        },
    );
    let displacement = (near(), near()).prop_map(|(position_m, velocity_mps)| {
        Key::Displacement(DisplacementKey { position_m, velocity_mps })
    });
    (prop_oneof![bicycle, displacement], prop::collection::vec(near(), 0..=HORIZON_LEN))
}

/// Agents pass in turn, all with a forecast that they stand.
fn pass_all(memory: &mut RetrievalMemory, passages: &[(Key, Vec<[f32; 2]>)]) {
    let position_m = |key: &Key| match key {
        Key::Bicycle(key) => key.position_m,
        Key::Displacement(key) => key.position_m,
    };
    let (mut stamp_ns, mut retrieved) = (0, Retrieved::default());
    for ((key, path), agent) in passages.iter().zip(1..) {
        stamp_ns += 10_000_000_000;
        memory.observe(stamp_ns, [(agent, position_m(key))]);
        let (query, forecast_m) = (Query { stamp_ns, agent, key: *key }, [position_m(key); HORIZON_LEN]);
        memory.retrieve_and_store(&query, &forecast_m, &mut retrieved);
        for &to_m in path {
            stamp_ns += STEP_NS.cast_signed();
            memory.observe(stamp_ns, [(agent, to_m)]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_memory_comes_back_from_its_file(passages in prop::collection::vec(passage(), 0..60)) {
        let folder = tempfile::tempdir().unwrap();
        let [path, again] = ["a.memory", "b.memory"].map(|name| folder.path().join(name));
        let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
        pass_all(&mut memory, &passages);
        memory.save(&path, WEIGHTS).unwrap();
        memory.end_session();
        let found = RetrievalMemory::load(&path, WEIGHTS, STEPS).unwrap();
        prop_assert_eq!(found.entry_count(), memory.entry_count());
        for (key, _) in &passages {
            prop_assert_eq!(retrieve(&found, 1, key), retrieve(&memory, 1, key));
        }
        found.save(&again, WEIGHTS).unwrap();
        prop_assert_eq!(std::fs::read(path).unwrap(), std::fs::read(again).unwrap());
    }
}

/// A file of the program's first version. It contains four vehicles that braked at 1 m/s², and four
/// pedestrians that turned left at 0.2 m/s².
#[test]
fn files_of_the_first_version_are_read_and_written_alike() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/retrieval/data/earlier.memory");
    let memory = RetrievalMemory::load(&path, WEIGHTS, STEPS).unwrap();
    assert_eq!(memory.entry_count(), 8);
    let walk = Key::Displacement(DisplacementKey { position_m: [0.0; 2], velocity_mps: [1.0, 0.0] });
    assert_eq!([at_x(0.0), walk].map(|key| retrieve(&memory, 1, &key).neighbours.len()), [4, 4]);
    assert!(!retrieve(&memory, 1, &at_x(0.0)).expected.is_empty());
    let folder = tempfile::tempdir().unwrap();
    let again = folder.path().join("again.memory");
    memory.save(&again, WEIGHTS).unwrap();
    assert!(std::fs::read(path).unwrap() == std::fs::read(again).unwrap());
}

/// Entries at one place, and then elsewhere more than the limit: only the newest are kept and written.
#[test]
fn the_oldest_entries_are_dropped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.memory");
    let kept = |memory: &RetrievalMemory| {
        memory.save(&path, WEIGHTS).unwrap();
        RetrievalMemory::load(&path, WEIGHTS, STEPS).unwrap().entry_count()
    };
    let mut memory = RetrievalMemory::new(HORIZON_LEN, STEP_NS);
    pass_all(&mut memory, &vec![(at_x(0.5), vec![[1.0, 0.0]; HORIZON_LEN]); 300]);
    assert_eq!((memory.entry_count(), kept(&memory)), (300, 128));
    let walk = |number: usize| {
        let position_m = [(number % 400) as f32 * 5.0, (number / 400) as f32 * 5.0];
        (Key::Displacement(DisplacementKey { position_m, velocity_mps: [1.0, 0.0] }), vec![[0.0; 2]])
    };
    memory.end_session();
    pass_all(&mut memory, &(0..131_072).map(walk).collect::<Vec<_>>());
    assert_eq!((memory.entry_count(), kept(&memory)), (131_072, 131_072));
    assert!(retrieve(&memory, 0, &at_x(0.5)).is_empty(), "the first ones are gone");
    assert!(!retrieve(&memory, 0, &walk(0).0).is_empty());
}

#[test]
fn files_that_are_no_memory_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.memory");
    after(3, -1.0, 0.5, 3.0).save(&path, WEIGHTS).unwrap();
    let other = RetrievalMemory::load(&path, "fedcba9876543210", STEPS).unwrap_err().to_string();
    assert!(
        other.contains("a.memory: a retrieval memory of the weights 0123456789ab, not of fedcba987654"),
        "{other}"
    );
    let steps = RetrievalMemory::load(&path, WEIGHTS, (5, STEP_NS)).unwrap_err().to_string();
    assert!(
        steps.contains("its forecasts have 4 steps of 500000000 ns, expected 5 of 500000000 ns"),
        "{steps}"
    );
    let whole = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        RetrievalMemory::load(&path, WEIGHTS, STEPS).unwrap_err()
    };
    for bytes in [&whole[..whole.len() - 1], b"x,y\n1,2\n", &[]] {
        assert!(matches!(refused(bytes), MemoryError::File(FileError::Format { .. })));
    }
    let offset = |name: &str| {
        let tensors = safetensors::SafeTensors::deserialize(&whole).unwrap();
        let data = tensors.tensor(name).unwrap().data();
        data.as_ptr() as usize - whole.as_ptr() as usize
    };
    let broken = |name: &str, bytes: &[u8]| {
        let mut broken = whole.clone();
        broken[offset(name)..][..bytes.len()].copy_from_slice(bytes);
        refused(&broken).to_string()
    };
    assert!(broken("memory.moment", &f32::NAN.to_le_bytes()).contains("memory.moment[0] is NaN"));
    assert!(broken("memory.moment", &1e9_f32.to_le_bytes()).contains("1000000000 m, outside the world"));
    assert!(broken("memory.departure", &7.0_f32.to_le_bytes()).contains("memory.departure[0] holds 7"));
    assert!(broken("memory.skill", &f32::INFINITY.to_le_bytes()).contains("memory.skill[0] is inf"));
    assert!(broken("memory.gait", &[2]).contains("memory.gait[0] is 2, at most 1 allowed"));
    assert!(broken("memory.driven", &[9]).contains("memory.driven[0] is 9, at most 4 allowed"));
    let [product, square] = [0.5_f32, -1.0].map(f32::to_le_bytes);
    assert!(broken("memory.skill", &[product, square].concat()).contains("memory.skill holds -1"));
    assert!(broken("memory.step_ns", &(-5_i64).to_le_bytes()).contains("memory.step_ns is -5"));
    let missing = RetrievalMemory::load(&folder.path().join("b.memory"), WEIGHTS, STEPS);
    assert!(matches!(missing, Err(MemoryError::File(FileError::Io { .. }))));
}
