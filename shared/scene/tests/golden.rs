//! Features, graph, maps and patches against the golden vectors of an independent float64 reference.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use std::path::PathBuf;

use safetensors::SafeTensors;
use scene::{
    AgentFrame, AgentType, ContextMap, EdgeRule, FeatureScales, MapBuilder, PatchOptions, State, Vertex,
    agent_frame, relation_features, state_features,
};

const FOLDERS: [&str; 4] = ["vehicle", "pedestrian", "plus", "literal"];
const TOLERANCE: f32 = 1e-4;

struct Golden {
    folder: &'static str,
    scene: serde_json::Value,
    bytes: Vec<u8>,
}

impl Golden {
    fn open(folder: &'static str) -> Self {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden").join(folder);
        let scene = serde_json::from_slice(&std::fs::read(path.join("scene.json")).unwrap()).unwrap();
        Self { folder, scene, bytes: std::fs::read(path.join("tensors.safetensors")).unwrap() }
    }

    fn tensor(&self, name: &str) -> Vec<f32> {
        let tensors = SafeTensors::deserialize(&self.bytes).unwrap();
        let view = tensors.tensor(name).unwrap();
        view.data().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    }

    fn len(&self, key: &str) -> usize {
        self.scene[key].as_u64().unwrap() as usize
    }

    fn config(&self, key: &str) -> f32 {
        self.scene["config"][key].as_f64().unwrap() as f32
    }

    fn scales(&self) -> FeatureScales {
        FeatureScales { position: self.config("position_scale"), velocity: self.config("velocity_scale") }
    }

    fn state(&self, step: usize, agent: usize) -> Option<State> {
        let pair = |key: &str| [0, 1].map(|axis| self.scene[key][step][agent][axis].as_f64().unwrap() as f32);
        self.scene["present"][step][agent].as_bool().unwrap().then(|| State {
            position_m: pair("position_m"),
            velocity_mps: pair("velocity_mps"),
            heading_rad: self.scene["heading_rad"][step][agent].as_f64().unwrap() as f32,
        })
    }

    fn states(&self, step: usize) -> Vec<Option<State>> {
        (0..self.len("agents")).map(|agent| self.state(step, agent)).collect()
    }

    fn frame(&self, agent: usize) -> AgentFrame {
        let history: Vec<_> = (0..self.len("history_len")).map(|step| self.state(step, agent)).collect();
        agent_frame(&history).unwrap()
    }

    /// The two parts of the window: name, first step, number of steps.
    fn parts(&self) -> [(&'static str, usize, usize); 2] {
        let history_len = self.len("history_len");
        [("history", 0, history_len), ("future", history_len, self.len("horizon_len"))]
    }

    fn map(&self) -> ContextMap {
        let origin = [0, 1].map(|axis| self.scene["map_origin_m"][axis].as_f64().unwrap() as f32);
        let [rows, cols] = [0, 1].map(|side| self.scene["map_shape"][side].as_u64().unwrap() as usize);
        let mut builder = MapBuilder::new(origin, rows, cols).unwrap();
        let (points, velocities) = (self.tensor("map.points"), self.tensor("map.velocities"));
        for (point, velocity) in points.chunks_exact(2).zip(velocities.chunks_exact(2)) {
            builder.visit([point[0], point[1]], [velocity[0], velocity[1]]);
        }
        builder.build()
    }

    fn assert_close(&self, what: &str, found: &[f32], expected: &[f32]) {
        assert_eq!(found.len(), expected.len(), "{}/{what}", self.folder);
        let largest = expected.iter().fold(0.0_f32, |most, v| most.max(v.abs()));
        for (at, (f, e)) in found.iter().zip(expected).enumerate() {
            assert!((f - e).abs() <= TOLERANCE * largest, "{}/{what}[{at}]: {f}, expected {e}", self.folder);
        }
    }
}

#[test]
fn state_features_agree_with_the_golden_vectors() {
    for golden in FOLDERS.map(Golden::open) {
        let frames: Vec<_> = (0..golden.len("agents")).map(|agent| golden.frame(agent)).collect();
        for (part, first, len) in golden.parts() {
            let mut found = Vec::new();
            for step in first..first + len {
                for (state, frame) in golden.states(step).iter().zip(&frames) {
                    let features = state.map_or([0.0; 6], |s| state_features(frame, &s, golden.scales()));
                    found.extend(features);
                }
            }
            let name = format!("{part}.state");
            golden.assert_close(&name, &found, &golden.tensor(&name));
        }
    }
}

#[test]
fn relation_features_agree_with_the_golden_vectors() {
    for golden in FOLDERS.map(Golden::open) {
        for (part, first, len) in golden.parts() {
            let mut found = Vec::new();
            for step in first..first + len {
                let states = golden.states(step);
                for receiver in &states {
                    for sender in &states {
                        let pair = receiver.zip(*sender);
                        found.extend(
                            pair.map_or([0.0; 6], |(i, j)| relation_features(&i, &j, golden.scales())),
                        );
                    }
                }
            }
            let name = format!("{part}.relation");
            golden.assert_close(&name, &found, &golden.tensor(&name));
        }
    }
}

#[test]
fn edges_agree_with_the_golden_vectors() {
    for golden in FOLDERS.map(Golden::open) {
        let agents_len = golden.len("agents");
        let rule = EdgeRule::within(golden.config("edge_radius_m"));
        for (part, first, len) in golden.parts() {
            let mut edges = Vec::new();
            for step in 0..len {
                let states = golden.states(first + step);
                let vertices: Vec<_> = states
                    .iter()
                    .map(|s| s.map(|s| Vertex { position_m: s.position_m, agent_type: AgentType::Vehicle }))
                    .collect();
                rule.append(step as u16, &vertices, &mut edges);
            }
            assert!(edges.is_sorted(), "{}: edges are sorted", golden.folder);
            let mut found = vec![0.0; len * agents_len * agents_len];
            for edge in &edges {
                let [step, i, j] = [edge.step, edge.receiver, edge.sender].map(usize::from);
                found[(step * agents_len + i) * agents_len + j] = 1.0;
            }
            assert_eq!(found, golden.tensor(&format!("{part}.adjacency")), "{}/{part}", golden.folder);
        }
    }
}

#[test]
fn maps_agree_with_the_golden_vectors() {
    for golden in FOLDERS.map(Golden::open) {
        let map = golden.map();
        let density: Vec<f32> = map.density().collect();
        golden.assert_close("map.density", &density, &golden.tensor("map.density"));
        let along = |axis: usize| map.velocity_mps().map(move |v| v[axis]).collect::<Vec<f32>>();
        golden.assert_close("map.velocity", &[along(0), along(1)].concat(), &golden.tensor("map.velocity"));
    }
}

#[test]
fn patches_agree_with_the_golden_vectors() {
    for golden in FOLDERS.map(Golden::open) {
        let map = golden.map();
        let options = PatchOptions {
            side: golden.len("patch_size"),
            cell_m: golden.config("patch_cell_m"),
            ahead_m: 0.0,
        };
        let expected = golden.tensor("history.patches");
        let mut found = vec![0.0; expected.len()];
        let slots = found.chunks_exact_mut(options.len());
        let states = (0..golden.len("history_len")).flat_map(|step| golden.states(step));
        for (slot, state) in slots.zip(states) {
            if let Some(state) = state {
                map.patch(&state, options, slot);
            }
        }
        golden.assert_close("history.patches", &found, &expected);
    }
}
