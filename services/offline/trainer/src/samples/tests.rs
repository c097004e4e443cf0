use std::fmt::Write;

use proptest::prelude::*;
use scene::{MapBuilder, PatchOptions, State};

use super::ground::GroundSpooling;
use super::*;
use crate::options::onboard_config;

const STEPS: [usize; 2] = [4, 3];
const PATCH: PatchOptions = PatchOptions { side: 4, cell_m: 2.0, ahead_m: 0.0 };

/// Any bits, including infinities and NaN.
fn float() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits)
}

fn state() -> impl Strategy<Value = State> {
    (proptest::array::uniform2(float()), proptest::array::uniform2(float()), float())
        .prop_map(|(position_m, velocity_mps, heading_rad)| State { position_m, velocity_mps, heading_rad })
}

fn agent() -> impl Strategy<Value = Arc<Agent>> {
    let states = |len: usize| proptest::collection::vec(proptest::option::of(state()), len);
    let patches = proptest::collection::vec(proptest::option::of(0..u32::MAX), STEPS[0] + STEPS[1]);
    let head = (any::<u64>(), 0..3_u32, proptest::option::of(float()), any::<bool>());
    (head, states(STEPS[0]), states(STEPS[1]), patches).prop_map(
        |((id, agent_type, length_m, counts), history, future, patches)| {
            let agent_type = AgentType::try_from(agent_type).unwrap();
            Arc::new(Agent { id, agent_type, length_m, history, future, patches, counts })
        },
    )
}

fn scenes() -> impl Strategy<Value = Vec<Scene>> {
    let scene = proptest::collection::vec(agent(), 0..6).prop_map(|agents| Scene { agents });
    proptest::collection::vec(scene, 1..20)
}

fn bits(state: &State) -> [u32; 5] {
    let State { position_m: [x, y], velocity_mps: [vx, vy], heading_rad } = *state;
    [x, y, vx, vy, heading_rad].map(f32::to_bits)
}

/// All attributes of an agent, to the bit.
fn attributes(agent: &Agent) -> impl PartialEq + std::fmt::Debug + use<> {
    let Agent { id, agent_type, length_m, history, future, patches, counts } = agent.clone();
    let states = |states: Vec<Option<State>>| -> Vec<Option<[u32; 5]>> {
        states.iter().map(|state| state.as_ref().map(bits)).collect()
    };
    ((id, agent_type, length_m.map(f32::to_bits), counts), states(history), states(future), patches)
}

/// The scenes after being written and read.
fn spooled(scenes: &[Scene]) -> Samples {
    let folder = tempfile::tempdir().unwrap();
    let mut spooling = Spooling::create(folder.path()).unwrap();
    let windows: Vec<Window> =
        scenes.iter().map(|scene| scene.append_to(&mut spooling, 0).unwrap()).collect();
    let sites = runs(&windows, |_, _| true);
    Samples {
        sets: vec![SetSamples { set: DataSet::EthUcy, windows, sites }],
        sources: Vec::new(),
        spool: spooling.finish().unwrap(),
        steps: STEPS,
        grounds: Vec::new(),
        sites: Vec::new(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn scenes_read_back_to_the_bit(scenes in scenes()) {
        let samples = spooled(&scenes);
        for (scene, window) in scenes.iter().zip(&samples.sets[0].windows).rev() {
            let read = samples.scene(window).unwrap();
            prop_assert_eq!(scene.agents.len(), read.agents.len());
            for (agent, read) in scene.agents.iter().zip(&read.agents) {
                prop_assert_eq!(attributes(agent), attributes(read));
            }
        }
    }

    #[test]
    fn spread_agents_are_every_nth_with_a_target(scenes in scenes(), len_max in 1_usize..30) {
        let samples = spooled(&scenes);
        for agent_type in wire::AGENT_TYPES {
            let agents = || scenes.iter().flat_map(|scene| &scene.agents);
            let counted = || agents().filter(|agent| agent.counts && agent.agent_type == agent_type);
            let stride = counted().count().div_ceil(len_max).max(1);
            let expected: Vec<_> = counted().step_by(stride).map(|agent| attributes(agent)).collect();
            let spread = samples.spread(&samples.sets, agent_type, len_max);
            let spread: Vec<_> = spread.map(|agent| attributes(&agent.unwrap())).collect();
            prop_assert!(spread.len() <= len_max);
            prop_assert_eq!(spread, expected);
        }
    }

    #[test]
    fn patches_read_back_in_half_precision(
        patches in proptest::collection::vec((state(), proptest::collection::vec(-70.0_f32..70.0, PATCH.len())), 1..9),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let mut spooling = Spooling::create(folder.path()).unwrap();
        spooling.append(&[7_u8; 3]).unwrap();
        let mut ground = GroundSpooling::new(&mut spooling);
        patches.iter().for_each(|(state, patch)| ground.push(state, patch).unwrap());
        let mut ground = ground.finish().unwrap();
        let spool = spooling.finish().unwrap();
        let mut builder = MapBuilder::new([-8.0, -8.0], 16, 16).unwrap();
        builder.visit([1.0, 2.0], [3.0, 4.0]);
        let site = builder.build();
        prop_assert!(ground.view(&spool, 0, MapKind::Site).is_none());
        ground.set_site(Some(site.clone()));
        for (number, (state, patch)) in patches.iter().enumerate().rev() {
            let patch_of = |kind: MapKind| {
                let mut values = vec![0.5];
                let view = ground.view(&spool, 0, kind).unwrap();
                view.extend(number as u32, PATCH, &mut values).unwrap();
                values
            };
            let halves = patch.iter().map(|&value| half::f16::from_f32(value).to_f32());
            let online: Vec<f32> = std::iter::once(0.5).chain(halves).collect();
            prop_assert_eq!(patch_of(MapKind::Online), online);
            let mut of_site = vec![0.5; 1 + PATCH.len()];
            site.patch(state, PATCH, &mut of_site[1..]);
            let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            prop_assert_eq!(bits(patch_of(MapKind::Site)), bits(of_site));
        }
    }
}

#[test]
fn reading_beyond_a_short_file_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows = String::new();
    for (frame, id) in (0..40).flat_map(|frame| (0..3).map(move |id| (frame, id))) {
        writeln!(rows, "{}\t{id}\t{:.3}\t{id}.0", frame * 10, 0.4 * f64::from(frame)).unwrap();
    }
    let train = folder.path().join("eth_ucy/zara1/train");
    std::fs::create_dir_all(&train).unwrap();
    std::fs::write(train.join("walk.txt"), rows).unwrap();
    let set = data::sets::Fold::ALL.map(DataSet::EthUcyFold).into_iter().find(|set| set.name() == "zara1");
    let config = onboard_config();
    let spooling = Spooling::create(&folder.path().join("checkpoints")).unwrap();
    let sets = [set.unwrap()];
    let samples =
        Samples::read(Selection::of_tests(folder.path(), &sets), &config, spooling, |_| ()).unwrap();
    let last = samples.sets[0].windows.last().unwrap();
    let patch =
        PatchOptions { side: config.patch_size, cell_m: config.patch_cell_m, ahead_m: config.patch_ahead_m };
    let patch_of = || samples.map(0, MapKind::Online).unwrap().extend(0, patch, &mut Vec::new());
    samples.scene(last).unwrap();
    patch_of().unwrap();
    samples.spool.truncate(100);
    assert!(matches!(samples.scene(last), Err(TrainError::Scratch { .. })));
    assert!(matches!(patch_of(), Err(TrainError::Scratch { .. })));
    let mut spread = samples.spread(&samples.sets, AgentType::Pedestrian, 5);
    assert!(matches!(spread.next(), Some(Err(TrainError::Scratch { .. }))));
}

#[test]
fn sites_are_runs_of_windows() {
    assert_eq!(runs(b"aabccc", |a, b| a == b), [0..2, 2..3, 3..6]);
    assert!(runs(b"", |a, b| a == b).is_empty());
}
