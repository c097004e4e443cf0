use std::collections::{BTreeMap, BTreeSet};

use wire::detection_flags;

use super::path::Point;
use super::*;

/// Frames in ten simulated minutes.
const TEN_MINUTES: usize = 7_500;
const FRAME_S: f32 = 0.08;

fn options(agents: usize, seed: u64) -> SceneOptions {
    SceneOptions { agents, seed, ..SceneOptions::default() }
}

fn scene(agents: usize, seed: u64) -> GeneratedScene {
    GeneratedScene::new(options(agents, seed)).expect("valid options")
}

/// Statistics of ten minutes of a scene.
#[derive(Debug, Default)]
struct Observed {
    /// Smallest number of agents present.
    agents_min: usize,
    /// Largest values in one step, by type: distance per second, change of speed per second, turn of the
    /// heading per metre.
    fastest_mps: [f32; 3],
    hardest_mps2: [f32; 3],
    /// Pairs of road users whose footprints overlap, over all frames.
    overlaps: usize,
    /// Pedestrians inside the footprint of a road user.
    run_over: usize,
    /// Longest time for which one agent stood still.
    longest_still_s: f32,
    /// Agents that left, by type.
    left: [usize; 3],
    /// Pedestrians on the roadway for which a road user stands, over all frames.
    yielded: usize,
}

fn observe(agents: usize, seed: u64) -> Observed {
    let mut scene = scene(agents, seed);
    let mut observed = Observed { agents_min: usize::MAX, ..Observed::default() };
    let mut before: BTreeMap<u64, Agent> = BTreeMap::new();
    let mut still_s: BTreeMap<u64, f32> = BTreeMap::new();
    for _ in 0..TEN_MINUTES {
        scene.advance();
        let now: BTreeMap<u64, Agent> = scene.agents.iter().map(|agent| (agent.id, *agent)).collect();
        assert_eq!(now.len(), scene.agents.len(), "ids are unique");
        observed.agents_min = observed.agents_min.min(now.len());
        for (id, agent) in &now {
            let still_s = still_s.entry(*id).or_default();
            *still_s = if agent.speed_mps < 0.2 { *still_s + FRAME_S } else { 0.0 };
            observed.longest_still_s = observed.longest_still_s.max(*still_s);
            let Some(last) = before.get(id) else { continue };
            let (k, moved_m) = (agent.agent_type.index(), distance_m(agent.position_m, last.position_m));
            observed.fastest_mps[k] = observed.fastest_mps[k].max(moved_m / FRAME_S);
            let change = (agent.speed_mps - last.speed_mps).abs() / FRAME_S;
            observed.hardest_mps2[k] = observed.hardest_mps2[k].max(change);
        }
        for (id, agent) in before.iter().filter(|(id, _)| !now.contains_key(id)) {
            observed.left[agent.agent_type.index()] += 1;
            still_s.remove(id);
        }
        count_encounters(&scene.agents, &mut observed);
        before = now;
    }
    observed
}

fn count_encounters(agents: &[Agent], observed: &mut Observed) {
    let on_foot = |agent: &&Agent| agent.agent_type == AgentType::Pedestrian;
    let users: Vec<&Agent> = agents.iter().filter(|agent| !on_foot(agent)).collect();
    for (i, a) in users.iter().enumerate() {
        observed.overlaps += users[..i].iter().filter(|b| overlap(a, b)).count();
        let stands_near = |p: &Agent| a.speed_mps < 0.2 && distance_m(p.position_m, a.position_m) < 8.0;
        for pedestrian in agents.iter().filter(on_foot) {
            observed.run_over += usize::from(inside(pedestrian.position_m, a));
            let [x, y] = pedestrian.position_m;
            observed.yielded += usize::from(x.abs().min(y.abs()) < 5.0 && stands_near(pedestrian));
        }
    }
}

fn distance_m(a: Point, b: Point) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn inside(point: Point, agent: &Agent) -> bool {
    let (sin, cos) = agent.heading_rad.sin_cos();
    let [x, y] = [point[0] - agent.position_m[0], point[1] - agent.position_m[1]];
    (cos * x + sin * y).abs() < agent.length_m / 2.0 && (cos * y - sin * x).abs() < agent.width_m / 2.0
}

/// Whether two footprints overlap (separating axes).
fn overlap(a: &Agent, b: &Agent) -> bool {
    if distance_m(a.position_m, b.position_m) > 10.0 {
        return false;
    }
    let axes_of = |agent: &Agent| {
        let (sin, cos) = agent.heading_rad.sin_cos();
        [[cos, sin], [-sin, cos]]
    };
    let dot = |p: Point, q: Point| p[0] * q[0] + p[1] * q[1];
    let reach = |agent: &Agent, axis: Point| {
        let [along, aside] = axes_of(agent).map(|own| dot(own, axis).abs());
        along * agent.length_m / 2.0 + aside * agent.width_m / 2.0
    };
    let apart = [b.position_m[0] - a.position_m[0], b.position_m[1] - a.position_m[1]];
    axes_of(a)
        .into_iter()
        .chain(axes_of(b))
        .all(|axis| dot(apart, axis).abs() < reach(a, axis) + reach(b, axis))
}

/// Motion is continuous and within the limits of each type; footprints of road users do not overlap, and no
/// pedestrian is inside one.
fn assert_natural(observed: &Observed, agents: usize) {
    assert!(observed.agents_min + 2 >= agents, "{observed:?}");
    let limits = [(14.0, 7.1), (6.6, 7.1), (2.4, 3.6)];
    for (k, (speed_mps, acceleration_mps2)) in limits.into_iter().enumerate() {
        assert!(observed.fastest_mps[k] < speed_mps, "{observed:?}");
        assert!(observed.hardest_mps2[k] < acceleration_mps2, "{observed:?}");
    }
    assert_eq!((observed.overlaps, observed.run_over), (0, 0), "{observed:?}");
    assert!(observed.yielded > 100, "{observed:?}");
}

#[test]
fn ten_minutes_of_the_default_scene_are_natural_and_flow() {
    let observed = observe(32, 1);
    assert_natural(&observed, 32);
    assert!(observed.longest_still_s < 90.0, "{observed:?}");
    let [vehicles, cyclists, pedestrians] = observed.left;
    assert!(vehicles > 120 && cyclists > 40 && pedestrians > 40, "{observed:?}");
}

#[test]
fn ten_minutes_of_the_fullest_scene_are_natural_and_flow() {
    let observed = observe(128, 2);
    assert_natural(&observed, 128);
    assert!(observed.longest_still_s < 240.0, "{observed:?}");
    let [vehicles, cyclists, pedestrians] = observed.left;
    assert!(vehicles > 60 && cyclists > 30 && pedestrians > 250, "{observed:?}");
}

#[test]
fn other_seeds_flow_too() {
    for (agents, seed) in [(16, 3), (32, 3), (48, 7), (64, 5)] {
        let observed = observe(agents, seed);
        assert!(observed.left[0] > 30 && observed.longest_still_s < 150.0, "seed {seed}: {observed:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_frames_to_the_bit() {
    let recording = |seed| scene(40, seed).recording(200);
    assert_eq!(recording(5), recording(5));
    assert_ne!(recording(5).frames, recording(6).frames);
}

#[test]
fn the_sensor_does_not_change_the_truth() {
    let clear = SceneOptions {
        clutter_mean: 0.0,
        miss_probability: 0.0,
        occlusion: false,
        identities: true,
        ..options(32, 1)
    };
    let (mut clear, mut real) = (GeneratedScene::new(clear).expect("valid options"), scene(32, 1));
    for _ in 0..100 {
        let (clear, real) = (clear.next_frame(), real.next_frame());
        assert_eq!(clear.truth, real.truth);
        assert_eq!(clear.detections.len(), clear.truth.len(), "everybody is seen");
        let near = |(d, t): (&wire::Detection, &Truth)| {
            d.id == t.id && distance_m([d.x_m, d.y_m], [t.x_m, t.y_m]) < 1.0
        };
        assert!(clear.detections.iter().zip(&clear.truth).all(near), "both are sorted by (type, id)");
    }
}

#[test]
fn the_number_of_agents_is_as_asked_for() {
    for agents in [1, 2, 3, 7, 20, 100, 127] {
        let recording = scene(agents, 9).recording(50);
        for (i, frame) in recording.frames.iter().enumerate() {
            assert_eq!(frame.stamp_ns, i as i64 * FRAME_INTERVAL_NS as i64);
            assert!((agents.saturating_sub(2)..=agents).contains(&frame.truth.len()), "{agents}");
            assert!(frame.detections.iter().all(|d| d.check().is_ok()));
        }
    }
}

#[test]
fn all_agents_of_a_complete_scene_are_detected() {
    for agents in [1, 30, 128] {
        let scene = GeneratedScene::new(SceneOptions::complete(agents)).expect("valid options");
        for frame in scene.recording(50).frames {
            assert!(frame.detections.iter().all(|d| d.has(detection_flags::HAS_ID)));
            let detected: BTreeSet<u64> = frame.detections.iter().map(|d| d.id).collect();
            let present: BTreeSet<u64> = frame.truth.iter().map(|t| t.id).collect();
            assert_eq!(frame.detections.len(), frame.truth.len());
            assert_eq!(detected, present);
        }
    }
}

#[test]
fn shares_of_one_give_a_single_type() {
    for (vehicle_share, cyclist_share, wanted) in [(1.0, 0.0, 0), (0.0, 1.0, 1), (0.0, 0.0, 2)] {
        let options = SceneOptions { vehicle_share, cyclist_share, ..options(10, 1) };
        let recording = GeneratedScene::new(options).expect("valid options").recording(20);
        assert!(recording.frames.iter().flat_map(|f| &f.truth).all(|t| t.agent_type == wanted));
    }
}

#[test]
fn options_out_of_range_are_refused() {
    let refused = GeneratedScene::new(options(129, 1)).unwrap_err();
    assert_eq!(refused.to_string(), "generated scene: agents = 129, expected 1 to 128");
}
