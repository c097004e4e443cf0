//! The memory of a place: what is told to whom, and when.

use proptest::prelude::*;
use scene::{Choice, Driving, FileError, Gait, Moment, PlaceMemory, Recall, Walking};

const STEP_NS: u64 = 500_000_000;
const STEP_S: f32 = 0.5;
const HORIZON_LEN: usize = 4;

const AT_ZERO: Driving = Driving {
    position_m: [0.0; 2],
    heading_rad: 0.0,
    speed_mps: 8.0,
    acceleration_mps2: 0.0,
    turn_rate_radps: 0.0,
};

fn moment(x_m: f32) -> Moment {
    Moment::Driving(Driving { position_m: [x_m, 0.0], ..AT_ZERO })
}

fn recall(memory: &PlaceMemory, agent: u64, moment: &Moment) -> Recall {
    let mut recall = Recall::default();
    memory.recall(agent, moment, &mut recall);
    recall
}

/// Straight on at 8 m/s, which is what is forecast for everybody.
fn straight(x_m: f32) -> Vec<[f32; 2]> {
    (1..=HORIZON_LEN).map(|step| [x_m + 4.0 * step as f32, 0.0]).collect()
}

/// A memory that saw agents, one after the other, who are at x = 0 at 8 m/s and brake by `acceleration_mps2` from there on,
/// observed every `tick_s`.
fn after(agents: u64, acceleration_mps2: f32, tick_s: f32, until_s: f32) -> PlaceMemory {
    let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
    let mut now_ns = 0;
    for agent in 1..=agents {
        for tick in 0..=(until_s / tick_s).round() as usize {
            let t_s = tick_s * tick as f32;
            now_ns += (f64::from(tick_s) * 1e9) as i64;
            assert!(memory.advance(now_ns));
            memory.observe(agent, [8.0 * t_s + 0.5 * acceleration_mps2 * t_s * t_s, 0.0]);
            if tick == 0 {
                let recalled = recall(&memory, agent, &moment(0.0));
                memory.remember(agent, &moment(0.0), &straight(0.0), &recalled);
            }
        }
        now_ns += 10_000_000_000;
    }
    memory
}

/// The changes of acceleration that are told to somebody else.
fn told(memory: &PlaceMemory, x_m: f32) -> Vec<f32> {
    let changes = recall(memory, 99, &moment(x_m)).expected.controls(1.2, STEP_S);
    changes[..HORIZON_LEN].iter().map(|[acceleration, _]| *acceleration).collect()
}

#[test]
fn where_others_braked_it_is_forecast_that_one_brakes() {
    for tick_s in [0.5, 0.1, 0.08] {
        let memory = after(60, -1.0, tick_s, 3.0);
        let told = told(&memory, 0.2);
        assert!(told[1..3].iter().all(|told| (told + 1.0).abs() < 0.15), "ticks of {tick_s} s: {told:?}");
        // The last that is known is the mean speed over the last step.
        let slower_mps = told.iter().sum::<f32>() * STEP_S;
        assert!((slower_mps + 1.75).abs() < 0.1, "ticks of {tick_s} s: {slower_mps}");
    }
}

/// Of agents that go now faster, now slower than forecast, at random, next to nothing is told.
#[test]
fn what_others_have_not_in_common_is_not_told() {
    let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
    let mut now_ns = 0;
    for agent in 1..=200_u64 {
        let acceleration = if agent.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63 == 0 { 1.5 } else { -1.5 };
        for step in 0..=HORIZON_LEN {
            let t_s = STEP_S * step as f32;
            now_ns += STEP_NS.cast_signed();
            memory.advance(now_ns);
            memory.observe(agent, [8.0 * t_s + 0.5 * acceleration * t_s * t_s, 0.0]);
            if step == 0 {
                let recalled = recall(&memory, agent, &moment(0.0));
                memory.remember(agent, &moment(0.0), &straight(0.0), &recalled);
            }
        }
        now_ns += 10_000_000_000;
    }
    let told = told(&memory, 0.0);
    assert!(told.iter().all(|told| told.abs() < 0.15), "{told:?}");
}

#[test]
fn only_what_was_driven_is_told() {
    let memory = after(20, -1.0, 0.5, 1.0);
    let told = told(&memory, 0.0);
    assert!(told[0] < -0.5, "{told:?}");
    assert_eq!(told[2..], [0.0; 2], "what is not known stays as it is");
}

#[test]
fn nothing_is_told_elsewhere_to_others_or_of_oneself() {
    let memory = after(1, -1.0, 0.5, 3.0);
    let told = |agent: u64, moment: Moment| !recall(&memory, agent, &moment).expected.is_empty();
    assert!(told(2, moment(0.0)));
    assert!(!told(1, moment(0.0)), "of oneself");
    assert!(!told(2, moment(9.0)), "elsewhere");
    assert!(!told(2, Moment::Driving(Driving { heading_rad: 1.0, ..AT_ZERO })), "another way");
    assert!(!told(2, Moment::Driving(Driving { speed_mps: 2.0, ..AT_ZERO })), "another speed");
}

#[test]
fn after_a_stay_time_begins_anew_and_everybody_is_somebody_else() {
    let mut memory = after(1, -1.0, 0.5, 3.0);
    assert!(!memory.advance(0), "time does not go back");
    memory.leave();
    assert!(memory.advance(0));
    assert!(!recall(&memory, 1, &moment(0.0)).is_empty(), "another agent of the same number");
}

/// Of a crowd too large to follow some are not remembered; when it is gone there is room for others.
#[test]
fn a_crowd_has_a_limit_and_leaves_its_room_to_others() {
    let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
    for (crowd, now_ns) in [(0..600, 0), (600..1_200, 10_000_000_000)] {
        assert!(memory.advance(now_ns));
        for agent in crowd {
            memory.observe(agent, [0.0; 2]);
            memory.remember(agent, &moment(0.0), &straight(0.0), &Recall::default());
        }
    }
    assert_eq!(memory.moments_len(), 2 * 512);
}

/// The weights whose forecasts are remembered.
const WEIGHTS: &str = "0123456789abcdef";
/// Their steps.
const STEPS: (usize, u64) = (HORIZON_LEN, STEP_NS);

/// A moment of who drives or walks about the origin, and where it goes in the steps after.
fn passage() -> impl Strategy<Value = (Moment, Vec<[f32; 2]>)> {
    let near = || [-9.0_f32..9.0, -9.0_f32..9.0];
    let driving = (near(), -3.0_f32..3.0, 1.0_f32..9.0, -2.0_f32..2.0, -0.3_f32..0.3).prop_map(
        |(position_m, heading_rad, speed_mps, acceleration_mps2, turn_rate_radps)| {
            Moment::Driving(Driving {
                position_m,
                heading_rad,
                speed_mps,
                acceleration_mps2,
                turn_rate_radps,
            })
        },
    );
    let walking = (near(), near())
        .prop_map(|(position_m, velocity_mps)| Moment::Walking(Walking { position_m, velocity_mps }));
    (prop_oneof![driving, walking], prop::collection::vec(near(), 0..=HORIZON_LEN))
}

/// Goes by, one after the other, everybody forecast to stand.
fn go_by(memory: &mut PlaceMemory, passages: &[(Moment, Vec<[f32; 2]>)]) {
    let position_m = |moment: &Moment| match moment {
        Moment::Driving(moment) => moment.position_m,
        Moment::Walking(moment) => moment.position_m,
    };
    let mut now_ns = 0;
    for ((moment, path), agent) in passages.iter().zip(1..) {
        now_ns += 10_000_000_000;
        memory.advance(now_ns);
        memory.observe(agent, position_m(moment));
        let recalled = recall(memory, agent, moment);
        memory.remember(agent, moment, &[position_m(moment); HORIZON_LEN], &recalled);
        for &to_m in path {
            now_ns += STEP_NS.cast_signed();
            memory.advance(now_ns);
            memory.observe(agent, to_m);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn a_memory_comes_back_from_its_file(passages in prop::collection::vec(passage(), 0..60)) {
        let folder = tempfile::tempdir().unwrap();
        let [path, again] = ["a.memory", "b.memory"].map(|name| folder.path().join(name));
        let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
        go_by(&mut memory, &passages);
        memory.save(&path, WEIGHTS).unwrap();
        memory.leave();
        let found = PlaceMemory::load(&path, WEIGHTS, STEPS).unwrap();
        prop_assert_eq!(found.moments_len(), memory.moments_len());
        for (moment, _) in &passages {
            prop_assert_eq!(recall(&found, 1, moment), recall(&memory, 1, moment));
        }
        found.save(&again, WEIGHTS).unwrap();
        prop_assert_eq!(std::fs::read(path).unwrap(), std::fs::read(again).unwrap());
    }
}

/// Moments at one spot, and over so many that there is no room for all: the newest are kept, and only they are written.
#[test]
fn the_oldest_moments_give_way() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.memory");
    let kept = |memory: &PlaceMemory| {
        memory.save(&path, WEIGHTS).unwrap();
        PlaceMemory::load(&path, WEIGHTS, STEPS).unwrap().moments_len()
    };
    let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
    go_by(&mut memory, &vec![(moment(0.5), vec![[1.0, 0.0]; HORIZON_LEN]); 300]);
    assert_eq!((memory.moments_len(), kept(&memory)), (300, 128));
    let walk = |number: usize| {
        let position_m = [(number % 400) as f32 * 5.0, (number / 400) as f32 * 5.0];
        (Moment::Walking(Walking { position_m, velocity_mps: [1.0, 0.0] }), vec![[0.0; 2]])
    };
    memory.leave();
    go_by(&mut memory, &(0..131_072).map(walk).collect::<Vec<_>>());
    assert_eq!((memory.moments_len(), kept(&memory)), (131_072, 131_072));
    assert!(recall(&memory, 0, &moment(0.5)).is_empty(), "what came first is forgotten");
    assert!(!recall(&memory, 0, &walk(0).0).is_empty());
}

#[test]
fn what_is_no_memory_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.memory");
    after(3, -1.0, 0.5, 3.0).save(&path, WEIGHTS).unwrap();
    let other = PlaceMemory::load(&path, "fedcba9876543210", STEPS).unwrap_err().to_string();
    assert!(
        other.contains("a.memory: remembers forecasts of the weights 0123456789ab, not of fedcba987654"),
        "{other}"
    );
    let steps = PlaceMemory::load(&path, WEIGHTS, (5, STEP_NS)).unwrap_err().to_string();
    assert!(
        steps.contains("its forecasts have 4 steps of 500000000 ns, expected 5 of 500000000 ns"),
        "{steps}"
    );
    let whole = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        PlaceMemory::load(&path, WEIGHTS, STEPS).unwrap_err()
    };
    for bytes in [&whole[..whole.len() - 1], b"x,y\n1,2\n", &[]] {
        assert!(matches!(refused(bytes), FileError::Format { .. }));
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
    let [told, squares] = [0.5_f32, -1.0].map(f32::to_le_bytes);
    assert!(broken("memory.skill", &[told, squares].concat()).contains("memory.skill holds -1"));
    assert!(broken("memory.step_ns", &(-5_i64).to_le_bytes()).contains("memory.step_ns is -5"));
    let missing = PlaceMemory::load(&folder.path().join("b.memory"), WEIGHTS, STEPS);
    assert!(matches!(missing, Err(FileError::Io { .. })));
}

#[test]
fn who_stands_has_no_moment() {
    let state =
        |speed_mps: f32| Some(scene::State { velocity_mps: [speed_mps, 0.0], ..scene::State::default() });
    assert_eq!(Moment::driving(&[state(3.0), state(0.05)], STEP_S), None);
    assert_eq!(Moment::driving(&[state(3.0), None], STEP_S), None);
    let slowing = Moment::driving(&[state(3.0), state(2.0)], STEP_S);
    let Some(Moment::Driving(slowing)) = slowing else { panic!("{slowing:?}") };
    assert_eq!(slowing.acceleration_mps2, -2.0);
}

/// Walkers at 1.25 m/s along the diagonal, forecast to go on so, who bear to the left from the origin on.
#[test]
fn where_others_bore_left_it_is_forecast_that_one_does() {
    let mut memory = PlaceMemory::new(HORIZON_LEN, STEP_NS);
    let at = |position_m| Moment::Walking(Walking { position_m, velocity_mps: [0.75, 1.0] });
    let straight: Vec<[f32; 2]> =
        (1..=HORIZON_LEN).map(|step| [0.375 * step as f32, 0.5 * step as f32]).collect();
    let left = |step: usize| {
        let [along, across] = [0.625 * step as f32, 0.05 * (step * step) as f32];
        [0.6 * along - 0.8 * across, 0.8 * along + 0.6 * across]
    };
    let mut now_ns = 0;
    for agent in 1..=40 {
        for step in 0..=HORIZON_LEN {
            now_ns += STEP_NS.cast_signed();
            memory.advance(now_ns);
            memory.observe(agent, left(step));
            if step == 0 {
                let recalled = recall(&memory, agent, &at([0.0; 2]));
                memory.remember(agent, &at([0.0; 2]), &straight, &recalled);
            }
        }
        now_ns += 10_000_000_000;
    }
    let recalled = recall(&memory, 99, &at([0.1, -0.1]));
    let told = recalled.expected.displacements(1.0_f32.atan2(0.75));
    let across: f32 = told[..HORIZON_LEN].iter().map(|[_, left]| left).sum();
    assert!((across - 0.8).abs() < 0.15, "{told:?}");
    assert!(told[..HORIZON_LEN].iter().all(|[along, _]| along.abs() < 0.02), "{told:?}");
    assert!(recalled.likes.len() > 20, "{}", recalled.likes.len());
    let beside = recall(&memory, 99, &at([7.5, 0.0]));
    assert!(
        beside.expected.is_empty() && !beside.likes.is_empty(),
        "too far for what is in common, not for a path"
    );
    assert!(recall(&memory, 99, &at([12.0, 0.0])).is_empty(), "too far");
    let driver = Moment::Driving(Driving { heading_rad: 0.9, speed_mps: 1.25, ..AT_ZERO });
    assert!(recall(&memory, 99, &driver).is_empty(), "of other gait");
}

/// A path of two steps to (x, y).
fn to(x: f32, y: f32) -> [[f32; 2]; wire::HORIZON_MAX] {
    let mut path = [[0.0; 2]; wire::HORIZON_MAX];
    (path[0], path[1]) = ([0.5 * x, 0.5 * y], [x, y]);
    path
}

/// What is chosen of paths, the first `probability.len()` of them modes.
fn choose(
    gait: Gait,
    paths: &[[[f32; 2]; wire::HORIZON_MAX]],
    probability: &[f32],
    weights: &[f32],
) -> Vec<(usize, f32)> {
    let mut choice = Choice::default();
    choice.choose(gait, paths, 2, probability, weights.iter().copied());
    choice.chosen().collect()
}

#[test]
fn what_many_did_stands_in_for_the_mode_that_is_missed_least() {
    // The second mode is nearly the first. Two went left, where no mode goes; one went where the third mode goes.
    let paths = [to(4.0, 0.0), to(4.1, 0.0), to(2.0, 0.0), to(0.0, 4.0), to(0.0, 4.2), to(2.0, 0.1)];
    let chosen = choose(Gait::Walking, &paths, &[0.5, 0.2, 0.3], &[1.0, 0.9, 1.0]);
    assert_eq!(chosen.iter().map(|(path, _)| *path).collect::<Vec<_>>(), [0, 3, 2]);
    let total = 8.0 + 2.9;
    for ((_, probability), of_its_own) in chosen.iter().zip([8.0 * 0.7, 1.9, 8.0 * 0.3 + 1.0]) {
        assert!((probability - of_its_own / total).abs() < 1e-6, "{chosen:?}");
    }
}

#[test]
fn modes_stay_where_others_did_what_they_tell() {
    let modes = [to(4.0, 0.0), to(0.0, 4.0), to(-4.0, 0.0)];
    let same = [modes.as_slice(), &[to(4.0, 0.0)]].concat();
    assert_eq!(choose(Gait::Walking, &modes, &[0.2, 0.3, 0.5], &[]), [(0, 0.2), (1, 0.3), (2, 0.5)]);
    let stayed = choose(Gait::Driving, &same, &[0.2, 0.3, 0.5], &[1.0]);
    assert_eq!(stayed.iter().map(|(path, _)| *path).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(stayed[0].1 > 0.2, "{stayed:?}");
}

#[test]
fn few_modes_give_way() {
    let modes: Vec<_> = (0..8).map(|mode| to(1.0 + 0.01 * mode as f32, 0.0)).collect();
    let others: Vec<_> = (0..9).map(|other| to(0.0, 4.0 * other as f32)).collect();
    for (gait, most) in [(Gait::Driving, 5), (Gait::Walking, 3)] {
        let chosen = choose(gait, &[&modes[..], &others].concat(), &[1.0 / 8.0; 8], &[1.0; 9]);
        assert_eq!(chosen.iter().filter(|(path, _)| *path >= 8).count(), most, "{chosen:?}");
        let sum: f32 = chosen.iter().map(|(_, probability)| probability).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{chosen:?}");
    }
}
